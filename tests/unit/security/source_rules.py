"""What the source of the package must not do with files, found in its syntax tree."""

import ast
from collections.abc import Iterator
from functools import cache

FORBIDDEN_MODULES = {
    "pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "dbm",
    "code", "codeop", "runpy", "pty", "xmlrpc", "telnetlib", "ftplib",
}  # fmt: skip
"""Modules that execute what a file or a stranger holds, or speak in the open."""

FORBIDDEN_CALLS = {
    "eval", "exec", "compile", "__import__", "execfile", "input",
    "os.system", "os.popen", "os.execv", "os.execvp", "os.spawnl",
    "pickle.load", "pickle.loads", "torch.load", "torch.hub.load", "torch.jit.load",
    "yaml.load", "yaml.load_all", "yaml.full_load", "yaml.unsafe_load",
    "numpy.fromfile", "np.fromfile", "np.memmap", "np.lib.format.read_array",
    "pandas.read_pickle", "pd.read_pickle", "shutil.unpack_archive", "tempfile.mktemp",
    "importlib.util.spec_from_file_location",
}  # fmt: skip

UNBOUNDED = {"read_text", "read_bytes", "readlines"}
"""Methods that read a whole file however long it is."""

OPENERS = {"h5py.File", "np.load", "numpy.load", "zipfile.ZipFile", "scipy.io.loadmat", "loadmat"}
"""Calls that hand a file to a parser: their modules are known by name."""


def violations(source: str) -> Iterator[tuple[int, str]]:
    """Yield what must be nowhere, as line and words."""
    for node in _telling(source):
        for module in _imported(node):
            if module.split(".")[0] in FORBIDDEN_MODULES:
                yield node.lineno, f"import {module}"
        if not isinstance(node, ast.Call):
            continue
        name = _name(node.func)
        if name in FORBIDDEN_CALLS:
            yield node.lineno, name
        options = {word.arg: word.value for word in node.keywords}
        if name in ("np.load", "numpy.load") and not _is(options.get("allow_pickle"), False):
            yield node.lineno, f"{name} without allow_pickle=False"
        if "shell" in options and not _is(options["shell"], False):
            yield node.lineno, f"{name} with a shell"
        if "weights_only" in options and not _is(options["weights_only"], True):
            yield node.lineno, f"{name} with weights_only off"


def unbounded_reads(source: str) -> Iterator[tuple[int, str]]:
    """Yield reads of whole files: `path.read_text()`, `file.read()`, `json.load(file)`."""
    for node in _telling(source):
        if not isinstance(node, ast.Call):
            continue
        name = _name(node.func)
        if isinstance(node.func, ast.Attribute) and node.func.attr in UNBOUNDED:
            yield node.lineno, name
        if name in ("json.load", "tomllib.load", "csv.reader", "np.loadtxt", "np.genfromtxt"):
            yield node.lineno, name
        if isinstance(node.func, ast.Attribute) and node.func.attr == "read" and not node.args:
            yield node.lineno, f"{name}()"


def opens(source: str) -> Iterator[tuple[int, str]]:
    """Yield calls that hand a file to a parser of containers."""
    for node in _telling(source):
        if isinstance(node, ast.Call) and (name := _name(node.func)) in OPENERS:
            yield node.lineno, name


@cache
def _telling(source: str) -> tuple[ast.Call | ast.Import | ast.ImportFrom, ...]:
    """Give the nodes that rules are about; a source is parsed once for all rules."""
    kinds = (ast.Call, ast.Import, ast.ImportFrom)
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds))


def _name(function: ast.expr) -> str:
    """Give what is called, `a.b.c`; of what is called on a value, the last words."""
    words: list[str] = []
    while isinstance(function, ast.Attribute):
        words.append(function.attr)
        function = function.value
    words.append(function.id if isinstance(function, ast.Name) else "…")
    return ".".join(reversed(words))


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.ImportFrom):
        return [node.module or ""]
    return []


def _is(node: ast.expr | None, value: object) -> bool:
    return isinstance(node, ast.Constant) and node.value is value

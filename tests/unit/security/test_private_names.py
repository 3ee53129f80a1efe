"""What a dependency calls private may change with any version: nothing here uses it."""

import ast
import importlib
import inspect
import pkgutil
import queue
import random
import textwrap
from functools import cache

import pytest

import orbitfb

DOCUMENTED = {
    ("_Told", "_on_step"): "how stable-baselines3 wants a callback written",
}
"""Names with an underscore that the documentation of a dependency tells to use."""
DEFINITIONS = ast.FunctionDef | ast.AsyncFunctionDef
OURS = ("orbitfb", "builtins", "typing", "abc", "enum")


def is_private(name):
    return name.startswith("_") and not name.startswith("__") and name != "_abc_impl"


def modules():
    for found in pkgutil.walk_packages(orbitfb.__path__, "orbitfb."):
        if not found.name.endswith("__main__"):
            yield importlib.import_module(found.name)


def is_of_itself(part):
    return isinstance(part.value, ast.Name) and part.value.id == "self"


@cache
def used(its):
    """Private names of itself that a class reads, and names that it defines."""
    parts = [*ast.walk(ast.parse(textwrap.dedent(inspect.getsource(its))))]
    own = [part for part in parts if isinstance(part, ast.Attribute) and is_of_itself(part)]
    stored = {part.attr for part in own if isinstance(part.ctx, ast.Store)}
    defined = {part.name for part in parts if isinstance(part, DEFINITIONS)}
    read = {part.attr for part in own if not isinstance(part.ctx, ast.Store)}
    return {name for name in read if is_private(name)}, stored | defined


def violations(its):
    """Private names of its dependencies that a class overrides or reads."""
    ours = [base for base in its.__mro__ if base.__module__.split(".")[0] == "orbitfb"]
    theirs = [base for base in its.__mro__ if base.__module__.split(".")[0] not in OURS]
    if not theirs:
        return set()
    private = {key for base in theirs for key in vars(base) if is_private(key)}
    read, written = used(its)
    defined = {name for base in ours for name in (*used(base)[1], *vars(base))}
    return (read - written - defined) | (private & (read | written))


class Reads(queue.Queue):
    def size(self):
        return self._qsize()


class Overrides(queue.Queue):
    def _qsize(self):
        return 0


class OfAnInstance(random.Random):
    def own(self):
        self._mine = 1
        return self._mine, self._not_there


@pytest.mark.parametrize(
    ("its", "name"), [(Reads, "_qsize"), (Overrides, "_qsize"), (OfAnInstance, "_not_there")]
)
def test_it_sees_them(its, name):
    assert violations(its) == {name}


@pytest.mark.nightly  # it imports the whole package
def test_no_class_uses_or_overrides_what_a_dependency_calls_private():
    wrong = {}
    for module in modules():
        for name, its in vars(module).items():
            if inspect.isclass(its) and its.__module__ == module.__name__:
                wrong |= {(name, key): module.__name__ for key in violations(its)}
    assert set(wrong) == set(DOCUMENTED), wrong


def test_no_module_imports_what_a_dependency_calls_private(repository):
    wrong = []
    for path in sorted((repository / "orbitfb").rglob("*.py")):
        for part in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(part, ast.ImportFrom):
                names = [*(part.module or "").split("."), *(alias.name for alias in part.names)]
                wrong += [f"{path}: {name}" for name in names if is_private(name)]
    assert wrong == []

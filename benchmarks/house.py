"""How orderly is the source: files per folder, loose modules, lengths, circles, what tests took.

    make house        # or: python -m benchmarks.house

A circle is a set of modules of which each imports, over others or not, every other one. Imports
within functions count, those for type checkers too. What tests took stands in `build/times` after
they ran.
"""

import ast
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
LOOSE = {"__init__.py", "__main__.py"}
"""Modules that may stand beside the packages."""
MOST = 20
"""Modules of a folder, beyond which nobody sees at a glance what is in it."""


def sources(root: Path) -> list[Path]:
    """Every module of the package."""
    return sorted((root / "orbitfb").rglob("*.py"))


def loose(root: Path) -> list[str]:
    """Names of modules that have no package of their own."""
    return sorted(path.name for path in (root / "orbitfb").glob("*.py") if path.name not in LOOSE)


def crowded(root: Path) -> dict[str, int]:
    """Folders with too many modules; `__init__` is the folder itself and does not count."""
    files = (path for path in sources(root) if path.name != "__init__.py")
    count = Counter(str(path.parent.relative_to(root)) for path in files)
    return {folder: number for folder, number in sorted(count.items()) if number > MOST}


def imports(root: Path) -> dict[str, set[str]]:
    """Of each module, the modules of the package that it imports."""
    named = {_name(path, root): path for path in sources(root)}
    return {
        name: {target for text in _imported(path) for target in _modules(text, named)} - {name}
        for name, path in named.items()
    }


def circles(arrows: Mapping[str, set[str]]) -> list[list[str]]:
    """Sets of more than one module that all reach each other."""
    reached = {name: _reached(name, arrows) for name in arrows}
    found = {
        frozenset(other for other in reached[name] if name in reached[other]) for name in arrows
    }
    return sorted(sorted(circle) for circle in found if len(circle) > 1)


def _name(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def _imported(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def _modules(text: str, known: Mapping[str, Path]) -> Iterator[str]:
    """The longest module that a dotted name begins with: a package alone when it is named alone."""
    parts = text.split(".")
    for length in range(len(parts), 0, -1):
        if (name := ".".join(parts[:length])) in known:
            yield name
            return


def _reached(start: str, arrows: Mapping[str, set[str]]) -> set[str]:
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        new = arrows[waiting.pop()] - seen
        seen |= new
        waiting += new
    return seen


def main() -> None:
    """Print the figures."""
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in sources(ROOT)}
    longest = max(lengths, key=lambda path: lengths[path])
    print(f"modules            {len(lengths)}")
    print(f"loose modules      {', '.join(loose(ROOT)) or 'none'}")
    folders = ", ".join(f"{folder} {number}" for folder, number in crowded(ROOT).items())
    print(f"folders over {MOST}    {folders or 'none'}")
    print(f"lines              median {median(lengths.values()):.0f}, "
          f"longest {lengths[longest]} ({longest.relative_to(ROOT)})")  # fmt: skip
    shown = "; ".join(" - ".join(circle) for circle in circles(imports(ROOT)))
    print(f"circles            {shown or 'none'}")
    for file in sorted((ROOT / "build" / "times").glob("*.txt")):
        rows = [line.split(maxsplit=2) for line in file.read_text().splitlines()[1:]]
        used = sum(float(row[0]) for row in rows)
        print(f"tests {file.stem:12s} {used:.0f} s of CPU, {len(rows)} tests")


if __name__ == "__main__":
    main()

"""Audit what is installed: `make audit`. Exit code 1 when something must be looked at.

1. Every installed package stands in constraints.txt with exactly that version.
2. Every package that pyproject.toml names is in the reviewed table of
   docs/explanations/dependencies.md, and the table names no other.
3. Known vulnerabilities of the pinned versions, by pip-audit, where the service that knows them
   (OSV) can be reached; where it cannot, that is said.
"""

import importlib.metadata
import re
import subprocess
import sys
import tempfile
import tomllib
import urllib.error
import urllib.request
from collections.abc import Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "docs/explanations/dependencies.md"
SERVICE = "https://api.osv.dev/"
PIP_AUDIT = "pip-audit==2.10.1"
TOOLS = {"pip", "setuptools", "wheel", "orbitfb"}
"""Installed beside what is pinned: what installs, and what is installed."""
LICENCES = {
    "Apache-2.0", "BSD-2-Clause", "BSD-3-Clause", "EPICS", "MIT", "MPL-2.0", "PSF-2.0",
}  # fmt: skip
"""Licences that a reviewer need not ask about."""


def normal(name: str) -> str:
    """Write a name as registries compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def pins(text: str) -> dict[str, str]:
    """Read constraints: exact versions by name; anything else is refused."""
    found: dict[str, str] = {}
    for line in text.splitlines():
        entry = line.partition("#")[0].strip()
        if not entry:
            continue
        name, equals, version = entry.partition("==")
        if not equals or not re.fullmatch(r"[\w.+!]+", version) or normal(name) in found:
            raise ValueError(f"constraints.txt: {entry!r} is no pin, or the second of its name")
        found[normal(name)] = version
    return found


def named(project: Mapping[str, object]) -> set[str]:
    """Give the packages that pyproject.toml names, all extras together."""
    extras: Mapping[str, list[str]] = project["optional-dependencies"]
    lines = [*project["dependencies"], *(line for extra in extras.values() for line in extra)]
    return {normal(re.split(r"[\s<>=!~\[;]", line)[0]) for line in lines}


def reviewed(page: str) -> dict[str, list[str]]:
    """Read the table: what for, licence, why trusted, by name."""
    rows = re.findall(r"^\| `([\w.-]+)` \|(.*)\|$", page, re.MULTILINE)
    return {normal(name): [cell.strip() for cell in rest.split("|")] for name, rest in rows}


def unpinned(installed: Iterable[tuple[str, str]], pinned: Mapping[str, str]) -> list[str]:
    """Say which installed packages are not the pinned ones."""
    problems = []
    for name, version in sorted(installed):
        wanted, plain = pinned.get(normal(name)), version.partition("+")[0]
        if normal(name) in TOOLS:
            continue
        if wanted is None:
            problems.append(f"{name} {version} is installed and not in constraints.txt")
        elif plain != wanted:
            problems.append(f"{name} {version} is installed, constraints.txt says {wanted}")
    return problems


def unreviewed(names: set[str], table: Mapping[str, list[str]]) -> list[str]:
    """Say what the table lacks, has too much, or leaves empty."""
    problems = [f"{name} has no row in {TABLE.name}" for name in sorted(names - set(table))]
    problems += [f"{name} is in {TABLE.name} and nowhere else" for name in set(table) - names]
    for name, cells in table.items():
        if len(cells) != 3 or not all(cells):
            problems.append(f"{name}: what for, licence and why must be told in {TABLE.name}")
        elif cells[1] not in LICENCES:
            problems.append(f"{name}: the licence {cells[1]!r} is not one of those agreed on")
    return problems


def vulnerable() -> int:
    """Ask pip-audit about every pin; 0: it knows nothing against them, or cannot be asked."""
    try:
        urllib.request.urlopen(SERVICE, timeout=10.0).close()
    except urllib.error.HTTPError:
        pass  # it answers
    except (OSError, ValueError) as error:
        print(f"pip-audit: skipped, {SERVICE} cannot be reached ({error}); the pins are reviewed")
        return 0
    with tempfile.TemporaryDirectory() as place:
        subprocess.run([sys.executable, "-m", "venv", place], check=True)
        python = f"{place}/bin/python"
        fetch = [python, "-m", "pip", "install", "--quiet", PIP_AUDIT]
        if subprocess.run(fetch, check=False).returncode:
            print(f"pip-audit: skipped, {PIP_AUDIT} cannot be installed; the pins are reviewed")
            return 0
        ask = ["--vulnerability-service", "osv", "--disable-pip", "--no-deps", "--requirement"]
        return subprocess.run(
            [python, "-m", "pip_audit", *ask, ROOT / "constraints.txt"], check=False
        ).returncode


def main() -> int:
    """Do all three, and print what was found."""
    pinned = pins((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    installed = [(its.name, its.version) for its in importlib.metadata.distributions()]
    problems = unpinned(installed, pinned)
    problems += unreviewed(named(project), reviewed(TABLE.read_text(encoding="utf-8")))
    for problem in problems:
        print(f"audit: {problem}")
    code = vulnerable()
    if problems or code:
        return 1
    print(f"audit: {len(installed)} packages are as pinned, {len(named(project))} are reviewed")
    return 0


if __name__ == "__main__":
    sys.exit(main())

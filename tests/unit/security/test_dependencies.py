"""The audit of the dependencies: its table is whole, and it finds what it is for."""

import importlib.metadata
import importlib.util
import tomllib
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


@pytest.fixture(scope="module")
def audit():
    spec = importlib.util.spec_from_file_location("audit", ROOT / ".ci/audit.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table(audit):
    return audit.reviewed(audit.TABLE.read_text(encoding="utf-8"))


def test_every_package_that_the_project_names_is_reviewed(audit, table):
    assert len(audit.named(PROJECT)) > 25
    assert audit.unreviewed(audit.named(PROJECT), table) == []


def test_every_package_that_the_project_names_is_pinned(audit):
    pins = audit.pins((ROOT / "constraints.txt").read_text())
    everywhere = {audit.normal(line.split(">")[0]) for line in PROJECT["dependencies"]}
    developing = audit.named({"dependencies": PROJECT["optional-dependencies"]["dev"],
                              "optional-dependencies": {}})  # fmt: skip
    assert everywhere | developing <= set(pins)


def test_every_pin_can_be_installed_on_the_first_python_that_the_project_allows(audit):
    """Debian 12 has 3.11.2; a pin that wanted 3.11.5 kept `make test` from setting up there."""
    first = PROJECT["requires-python"].removeprefix(">=") + ".0"
    wanting = {}
    for name in audit.pins((ROOT / "constraints.txt").read_text()):
        try:
            wants = importlib.metadata.metadata(name).get("Requires-Python") or ""
        except importlib.metadata.PackageNotFoundError:
            continue  # of another system
        if not SpecifierSet(wants).contains(first):
            wanting[name] = wants
    assert wanting == {}


def test_licences_are_those_that_the_packages_state(audit, table):
    differing = {}
    for name, (_, licence, _) in table.items():
        try:
            stated = importlib.metadata.metadata(name).get("License-Expression") or ""
        except importlib.metadata.PackageNotFoundError:
            continue  # of an extra that is not installed
        if stated and licence not in stated.replace("(", " ").replace(")", " ").split():
            differing[name] = (licence, stated)
    assert differing == {}


def test_it_finds_what_is_not_as_pinned(audit):
    pins = {"numpy": "2.4.6", "torch": "2.13.0", "prometheus-client": "0.26.0"}
    good = [("numpy", "2.4.6"), ("torch", "2.13.0+cpu"), ("prometheus_client", "0.26.0")]
    assert audit.unpinned([*good, ("pip", "25"), ("orbitfb", "0.1")], pins) == []
    problems = audit.unpinned([("numpy", "2.4.5"), ("evil", "1.0")], pins)
    assert problems == [
        "evil 1.0 is installed and not in constraints.txt",
        "numpy 2.4.5 is installed, constraints.txt says 2.4.6",
    ]


@pytest.mark.parametrize("line", ["numpy>=2", "numpy", "numpy==2 --hash", "a==1\nA==2", "-e ."])
def test_it_refuses_what_is_no_pin(audit, line: str):
    with pytest.raises(ValueError, match=r"is no pin"):
        audit.pins(line)


def test_it_finds_rows_that_lack_or_say_nothing(audit):
    table = audit.reviewed(
        "| `a` | x | MIT | y |\n| `b` | x | Proprietary | y |\n| `c` | | MIT | y |"
    )
    assert audit.unreviewed({"a", "b", "c", "d"}, table) == [
        "d has no row in dependencies.md",
        "b: the licence 'Proprietary' is not one of those agreed on",
        "c: what for, licence and why must be told in dependencies.md",
    ]
    assert audit.unreviewed({"b"}, {"b": ["x", "MIT", "y"], "e": ["x", "MIT", "y"]}) == [
        "e is in dependencies.md and nowhere else"
    ]


def test_it_says_that_nobody_can_be_asked(audit, monkeypatch, capsys):
    monkeypatch.setattr(audit, "SERVICE", "http://127.0.0.1:1/")
    assert audit.vulnerable() == 0
    assert "cannot be reached" in capsys.readouterr().out

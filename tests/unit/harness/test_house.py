"""Nothing lies loose, no folder is crowded, no modules import each other in a circle."""

from pathlib import Path

import pytest

from benchmarks.house import circles, crowded, imports, loose

ROOT = Path(__file__).parents[3]


def test_every_module_has_a_package():
    assert loose(ROOT) == []


def test_no_folder_is_crowded():
    assert crowded(ROOT) == {}


def test_no_modules_import_each_other_in_a_circle():
    assert circles(imports(ROOT)) == []


@pytest.fixture
def source(tmp_path: Path) -> Path:
    package = tmp_path / "orbitfb"
    (package / "full").mkdir(parents=True)
    for path in (package, package / "full"):
        (path / "__init__.py").write_text("")
    return tmp_path


def test_what_is_loose_crowded_or_circular_is_seen(source: Path):
    (source / "orbitfb" / "stray.py").write_text("")
    for number in range(21):
        (source / "orbitfb" / "full" / f"m{number}.py").write_text("")
    (source / "orbitfb" / "full" / "m1.py").write_text("def f():\n    import orbitfb.full.m2\n")
    (source / "orbitfb" / "full" / "m2.py").write_text("from orbitfb.full import m3\n")
    (source / "orbitfb" / "full" / "m3.py").write_text("from orbitfb.full.m1 import f\n")
    assert loose(source) == ["stray.py"]
    assert crowded(source) == {"orbitfb/full": 21}
    assert circles(imports(source)) == [[f"orbitfb.full.m{n}" for n in (1, 2, 3)]]


def test_a_package_that_its_own_module_names_is_no_circle(source: Path):
    (source / "orbitfb" / "full" / "a.py").write_text("from orbitfb.full import b\n")
    (source / "orbitfb" / "full" / "b.py").write_text("import math\n")
    assert circles(imports(source)) == []


def test_what_says_something_about_time_is_a_system_test():
    """`make test-alone` collects these only."""
    marked = [
        file
        for file in (ROOT / "tests/unit").rglob("test_*.py")
        if file != Path(__file__) and "mark.timing" in file.read_text(encoding="utf-8")
    ]
    assert marked == []

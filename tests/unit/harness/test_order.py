"""Each worker begins to collect elsewhere, and all of them collect the same."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from order import begin_elsewhere, folders_of_tests, sort_tests

ROOT = Path(__file__).parents[3]
SOURCE = pytest.Config.ArgsSource


def collects(number: int, config: pytest.Config, source: SOURCE = SOURCE.TESTPATHS) -> Any:
    """What a worker of three collects that was told to collect everything."""
    worker = SimpleNamespace(
        workerinput={"workerid": f"gw{number}", "workercount": 3},
        args_source=source,
        args=["tests"],
        rootpath=ROOT,
        getini=config.getini,
    )
    begin_elsewhere(worker)
    return worker.args


def test_every_worker_collects_every_file_of_tests(pytestconfig: pytest.Config):
    files = {
        file for file in (ROOT / "tests").rglob("test_*.py") if "tests/debian" not in str(file)
    }
    for number in range(3):
        folders = [Path(folder) for folder in collects(number, pytestconfig)]
        found = [file for folder in folders for file in folder.rglob("test_*.py")]
        assert len(found) == len(files) and set(found) == files


def test_each_begins_at_a_folder_of_its_own(pytestconfig: pytest.Config):
    assert len({collects(number, pytestconfig)[0] for number in range(3)}) == 3
    assert collects(1, pytestconfig, SOURCE.ARGS) == ["tests"]


def test_folders_inside_another_one_are_not_collected_twice(
    tmp_path: Path, pytestconfig: pytest.Config
):
    for name in ("a/test_1.py", "a/b/test_2.py", "ab/test_3.py", "debian/test_4.py", "c/d/d.py"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = folders_of_tests(pytestconfig, tmp_path)
    assert found == [str(tmp_path / "a"), str(tmp_path / "ab")]


def item(name: str) -> Any:
    return SimpleNamespace(nodeid=name, path=Path(name.split("::")[0]))


def test_all_run_in_one_order_with_the_longest_first():
    names = ("tests/unit/a/test_a.py::z", "tests/unit/a/test_a.py::b", "tests/unit/verdict/t.py::t")
    items = [item(name) for name in names]
    turned = [items[2], *items[:2]]
    sort_tests(items)
    sort_tests(turned)
    assert [item.nodeid for item in items] == [names[2], *names[:2]]
    assert items == turned


def test_what_waits_stands_among_what_computes():
    items = [item(f"tests/system/test_{n}.py::t") for n in range(2)]
    items += [item(f"tests/unit/a/test_{n}.py::t") for n in range(4)]
    sort_tests(items)
    assert [one.nodeid.split("/")[1] for one in items] == ["unit", "system", "unit"] * 2

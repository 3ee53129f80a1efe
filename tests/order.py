"""In which order tests are collected, and run.

Every worker of pytest-xdist collects all tests, and compiles what it imports if nobody has yet:
after a fresh set up that is 25 of the 45 s of computing which a collection takes. Workers that all
began with the same file would compile everything at the same time, each for itself. So each begins
at another folder, and finds compiled what the others came to before.
"""

from pathlib import Path

import pytest

LONG = tuple(f"tests/unit/{one}/" for one in ("verdict", "selection", "hypotheses", "screen"))
"""Folders whose modules take longest: begun last, one of them would keep a single core busy."""


def folders_of_tests(config: pytest.Config, tests: Path) -> list[str]:
    """Give the folders below one that hold files of tests, without those inside another one."""
    patterns, left_out = config.getini("python_files"), config.getini("norecursedirs")
    found: list[Path] = []
    for folder in sorted({file.parent for each in patterns for file in tests.rglob(each)}):
        inside = folder.relative_to(tests).parts
        if any(Path(part).match(pattern) for part in inside for pattern in left_out):
            continue
        if not found or found[-1] not in folder.parents:
            found.append(folder)
    return [str(folder) for folder in found]


def begin_elsewhere(config: pytest.Config) -> None:
    """Let a worker begin to collect at a folder of its own, if all tests are asked for."""
    worker = getattr(config, "workerinput", None)
    if worker is None or config.args_source is not pytest.Config.ArgsSource.TESTPATHS:
        return
    folders = folders_of_tests(config, config.rootpath / "tests")
    number = int(worker["workerid"].removeprefix("gw"))
    begin = number * len(folders) // worker["workercount"]
    config.args[:] = folders[begin:] + folders[:begin]


def sort_tests(items: list[pytest.Item]) -> None:
    """Put tests in the order in which they run, the same one for all workers.

    What takes longest comes first, so that all cores are busy to the end. Then system tests, which
    wait half of their time, are spread evenly among the others, which compute: workers that all
    wait leave cores idle.

    Args:
        items: All tests, in the order of their file within each file.
    """
    rank: dict[Path, tuple[bool, float]] = {}
    groups: dict[str, set[Path]] = {"first": set(), "wait": set(), "compute": set()}
    for item in items:
        waits = item.nodeid.startswith("tests/system/")
        group = "first" if item.nodeid.startswith(LONG) else "wait" if waits else "compute"
        groups[group].add(item.path)
    for group, files in groups.items():
        for number, file in enumerate(sorted(files)):
            rank[file] = (group != "first", (number + 0.5) / len(files))
    items.sort(key=lambda item: (*rank[item.path], item.path))

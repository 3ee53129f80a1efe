"""What each test takes: CPU seconds of its process and of the children that it has awaited.

Seconds of a clock say as much about the other programs of a computer; both are written.

    pytest --times=build/times/unit.txt

prints the ten tests that took most, and writes what each took, the most expensive first. Of the
setting up of a fixture that several tests share, the first one is told.
"""

import os
import time
from collections.abc import Generator
from pathlib import Path

import forked
import pytest
from _pytest.terminal import TerminalReporter

SHOWN = 10
_TIMES = "times"


def cpu() -> float:
    """CPU seconds of this process and of its children that have ended and were awaited."""
    return sum(os.times()[:4]) + forked.used()


class Times:
    """Measures where tests run, collects where reports arrive; with xdist these are two places."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._taken: dict[str, list[float]] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, bool, bool]:
        """Remember when a test began; its reports come from `pytest_runtest_makereport`."""
        item.stash[_BEGUN] = (cpu(), time.perf_counter())
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        """Tell with each phase what it took since the one before."""
        report = yield
        now = (cpu(), time.perf_counter())
        begun = item.stash[_BEGUN]
        item.stash[_BEGUN] = now
        taken = (now[0] - begun[0], now[1] - begun[1])
        report.user_properties = [*report.user_properties, (_TIMES, taken)]
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up the phases of each test."""
        for name, taken in report.user_properties:
            if name == _TIMES:
                told = self._taken.setdefault(report.nodeid, [0.0, 0.0])
                told[:] = (told[0] + taken[0], told[1] + taken[1])

    def pytest_terminal_summary(self, terminalreporter: TerminalReporter) -> None:
        """Print the most expensive tests and write all."""
        lines = lines_of(self._taken)
        total = [sum(taken[which] for taken in self._taken.values()) for which in (0, 1)]
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text("\n".join([HEADER, *lines, ""]))
        terminalreporter.section(f"{SHOWN} slowest")
        for line in [HEADER, *lines[:SHOWN]]:
            terminalreporter.write_line(line)
        terminalreporter.write_line(
            f"{total[0]:6.1f} {total[1]:6.1f}  all {len(self._taken)}, in {self._file}"
        )


_BEGUN = pytest.StashKey[tuple[float, float]]()
HEADER = " CPU s   wall  test"


def lines_of(taken: dict[str, list[float]]) -> list[str]:
    """A line for each test, the one with most CPU seconds first."""
    ordered = sorted(taken.items(), key=lambda entry: -entry[1][0])
    return [f"{used:6.2f} {wall:6.2f}  {name}" for name, (used, wall) in ordered]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let the file be named."""
    text = "write what each test takes to FILE, and print the slowest"
    parser.addoption("--times", metavar="FILE", type=Path, help=text)


def measure_times(config: pytest.Config) -> None:
    """Measure if a file is named."""
    if file := config.getoption("--times"):
        worker = hasattr(config, "workerinput")
        config.pluginmanager.register(Times(file), "times-worker" if worker else "times")

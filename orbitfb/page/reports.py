"""Diagnosis reports that may be shown: those that a diagnosis wrote into the data directory.

Nobody can name a file: a report is asked for by the name of its directory, which is looked up
among those that were found.
"""

import json
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbitfb.core.bounded import LARGEST_DIAGNOSIS

SUFFIX = ".diagnosis"
"""What the names of directories end with in which a diagnosis is written."""
REPORT, ANSWER = "report.html", "diagnosis.json"
LARGEST_REPORT = 64 << 20
"""Larger ones are not shown [bytes]."""
MOST = 1000
LONGEST_HEADLINE = 300


@dataclass(frozen=True, slots=True)
class Report:
    """A report that was found.

    Args:
        name: Of its directory.
        directory: Where it lies.
        time: When it was written [s since the epoch].
    """

    name: str
    directory: Path
    time: float

    def headline(self) -> str:
        """Give the answer in one sentence; empty where it cannot be read."""
        try:
            answer: Any = json.loads(_read(self.directory / ANSWER, LARGEST_DIAGNOSIS))
        except (OSError, ValueError, RecursionError):
            return ""
        told = answer.get("headline") if isinstance(answer, dict) else None
        return told[:LONGEST_HEADLINE] if isinstance(told, str) else ""

    def page(self) -> bytes:
        """Read it.

        Raises:
            OSError: It has gone, is no plain file, or is too large.
        """
        return _read(self.directory / REPORT, LARGEST_REPORT)


def find_reports(data_directory: Path) -> list[Report]:
    """List the reports of a data directory, the newest first.

    Args:
        data_directory: Where an archive and its segments lie, and diagnoses beside them.
    """
    found: list[Report] = []
    for parent in (data_directory, data_directory / "archive"):
        for directory in sorted(parent.glob(f"*{SUFFIX}"))[:MOST]:
            try:
                plain = stat.S_ISDIR(directory.lstat().st_mode)
                report = (directory / REPORT).lstat()
                answer = (directory / ANSWER).lstat()
            except OSError:
                continue
            if plain and stat.S_ISREG(report.st_mode) and stat.S_ISREG(answer.st_mode):
                found.append(Report(directory.name, directory, report.st_mtime))
    return sorted(found, key=lambda report: report.time, reverse=True)


def _read(path: Path, largest: int) -> bytes:
    """Read a plain file that is no link and not too large."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_size > largest:
            raise OSError(f"{path} is no plain file, or larger than {largest} bytes")
        return file.read(largest)

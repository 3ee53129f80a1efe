"""Diagnosis reports that may be shown: those that a diagnosis wrote into the data directory.

What a directory is called does not matter; that both files of a diagnosis lie in it does. Nobody
can name a file: a report is asked for by the name of its directory, which is looked up among those
that were found.
"""

import json
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from orbitfb.core.files.bounded import LARGEST_DIAGNOSIS

REPORT, ANSWER = "report.html", "diagnosis.json"
LARGEST_REPORT = 64 << 20
"""Larger ones are not shown [bytes]."""
MOST = 1000
"""In so many directories is looked at most, in the data directory and in its archive each."""
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
        for directory in islice(_directories(parent), MOST):
            try:
                report = (directory / REPORT).lstat()
                answer = (directory / ANSWER).lstat()
            except OSError:
                continue
            if stat.S_ISREG(report.st_mode) and stat.S_ISREG(answer.st_mode):
                found.append(Report(directory.name, directory, report.st_mtime))
    return sorted(found, key=lambda report: report.time, reverse=True)


def _directories(parent: Path) -> Iterator[Path]:
    """Give those in it that are no links and neither hidden nor of a name that no address takes."""
    try:
        with os.scandir(parent) as entries:
            for entry in entries:
                shown = entry.name.isprintable() and not entry.name.startswith(".")
                if shown and entry.is_dir(follow_symlinks=False):
                    yield Path(entry)
    except OSError:  # there is none yet
        return


def _read(path: Path, largest: int) -> bytes:
    """Read a plain file that is no link and not too large."""
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode) or status.st_size > largest:
            raise OSError(f"{path} is no plain file, or larger than {largest} bytes")
        return file.read(largest)

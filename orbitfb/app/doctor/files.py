"""Where the service keeps its files: writable, room enough, not on a file system that stalls."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from orbitfb.app.doctor.finding import Finding, Verdict
from orbitfb.config.tree import AppConfig
from orbitfb.control.client import is_running
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.files.ownership import runtime_directory
from orbitfb.history.columns import layout, row_bytes
from orbitfb.physics.places import Ring

_PART = "files"
_LEAST = 200e6
_DAY = 86_400.0


def look_at_files(config: AppConfig, ring: Ring | None) -> Iterator[Finding]:
    """Look at the data directory and at that of locks and sockets; nothing is left behind."""
    directory = config.data_directory.absolute()
    yield _data_directory(directory)
    yield _disk(directory, config, ring)
    try:
        where = runtime_directory()
    except OrbitFeedbackError as error:
        yield Finding(_PART, "locks and socket", Verdict.FAILED, str(error), "see there")
        return
    yield Finding(_PART, "locks and socket", Verdict.OK, str(where), figures={"path": str(where)})
    running = is_running(config.data_directory)
    told = "answers on this data directory" if running else "none on this data directory"
    yield Finding(_PART, "running service", Verdict.OK, told, figures={"running": running})


def _existing(directory: Path) -> Path:
    """Give the directory itself, or the nearest one above it that is there."""
    while not directory.exists() and directory != directory.parent:
        directory = directory.parent
    return directory


def _data_directory(directory: Path) -> Finding:
    there = _existing(directory)
    problem = ""
    if not there.is_dir():
        problem = f"{there} is no directory"
    else:
        try:
            with tempfile.TemporaryFile(dir=there) as file:
                file.write(b"orbitfb")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            problem = f"{there} cannot be written to ({error.strerror})"
    new = "" if there == directory else " (will be made)"
    return Finding(
        _PART,
        "data directory",
        Verdict.FAILED if problem else Verdict.OK,
        problem or f"{directory} is writable{new}",
        "name another with --data, or repair its permissions" if problem else "",
        {"path": str(directory), "exists": not new},
    )


def _disk(directory: Path, config: AppConfig, ring: Ring | None) -> Finding:
    free = shutil.disk_usage(_existing(directory)).free
    figures: dict[str, float] = {"free_bytes": free}
    told, days = f"{free / 1e9:.1f} GB free", float("inf")
    if ring is not None:
        columns = layout(ring.channels(config.ring.planes), config.epics.auxiliary)
        daily = row_bytes(columns) * config.loop.rate_hz * _DAY
        days = free / daily
        figures |= {"archive_bytes_per_day": daily, "days": days}
        told += f", the archive takes up to {daily / 1e9:.1f} GB a day (before it is compressed)"
    kept = config.history.archive.keep_gigabytes
    if free < _LEAST:
        verdict, advice = Verdict.FAILED, "make room, or name another place with --data"
    elif days < 1 and (kept is None or kept * 1e9 > free):
        verdict = Verdict.WARNING
        advice = "it is full within a day; make room, or set history.archive.keep_gigabytes"
    else:
        verdict, advice = Verdict.OK, ""
    return Finding(_PART, "disk", verdict, told, advice, figures)

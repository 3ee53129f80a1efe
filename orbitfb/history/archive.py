"""The archive: every tick on disk, written by a thread of its own, never in the loop's way."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import ArchiveError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Channels, TickRecord
from orbitfb.history.reader import read_archive
from orbitfb.history.recorder import Recorder
from orbitfb.history.settings import ArchiveSettings

__all__ = ["ArchiveSettings", "ArchiveStatus", "ArchiveWriter", "read_archive"]

_CLOSE_WAIT = 1.5


@dataclass(frozen=True, slots=True)
class ArchiveStatus:
    """How the archive is doing.

    Args:
        written: Ticks on disk since the start.
        dropped: Ticks lost since the start.
        waiting: Ticks in the queue.
        segment: File that is being filled, if any.
        problem: Why nothing is written at the moment; empty when all is well.
    """

    written: int
    dropped: int
    waiting: int
    segment: Path | None
    problem: str


class ArchiveWriter:
    """Writes every record to disk; a subscriber of the loop.

    The loop only puts the record into a queue. When the disk refuses, the loop goes on: ticks
    wait in the queue, the newest are dropped and counted once it is full, and the disk is tried
    again from time to time.

    Args:
        directory: Where the segments lie.
        channels: The names behind the vectors.
        settings: Sizes and times.
        on_error: Told once of each trouble, from the archive's thread.
        clock: Gives the names of the segments and their age; by default the system's.
        on_resumed: Told how many ticks were lost when a trouble is over, from the same thread.

    Raises:
        ArchiveError: The directory cannot be used.
        OwnershipError: Another writer uses it.
    """

    def __init__(
        self,
        directory: Path,
        channels: Channels,
        settings: ArchiveSettings,
        on_error: Callable[[ArchiveError], None] | None = None,
        clock: Clock | None = None,
        on_resumed: Callable[[int], None] | None = None,
    ) -> None:
        self._on_resumed = on_resumed
        self._directory = Path(directory)
        self._settings = settings
        self._on_error = on_error
        self._recorder = Recorder(self._directory, channels, settings, clock or SystemClock())
        self._queue: deque[TickRecord] = deque()
        self._written = 0
        self._refused = 0
        self._lost = 0
        self._problem = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="archive", daemon=True)
        self._thread.start()

    def __call__(self, record: TickRecord) -> None:
        """Take a record; never waits. Only the loop's thread may call this."""
        if self._stop.is_set() or len(self._queue) >= self._settings.queue:
            self._refused += 1
        else:
            self._queue.append(record)

    def status(self) -> ArchiveStatus:
        """Say how the archive is doing."""
        return ArchiveStatus(
            written=self._written,
            dropped=self._refused + self._lost,
            waiting=len(self._queue),
            segment=self._recorder.path,
            problem=self._problem,
        )

    def close(self) -> None:
        """Write what waits and stop; a disk that hangs is not waited for long."""
        self._stop.set()
        self._thread.join(_CLOSE_WAIT)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.is_set():
            due = max(due + self._settings.flush_interval, time.monotonic())
            while not self._stop.is_set() and time.monotonic() < due and self._tidy():
                pass
            self._stop.wait(max(0.0, due - time.monotonic()))
            if not self._drain():
                self._stop.wait(self._settings.retry_interval)
        self._drain()
        self._lost += len(self._queue)
        self._queue.clear()
        self._recorder.close()

    def _drain(self) -> bool:
        """Write all that waits; False if the disk refuses."""
        try:
            while written := self._recorder.write(self._queue):
                self._written += written
        except (OSError, RuntimeError) as error:
            self._report(
                f"the archive {self._directory} takes nothing at the moment ({error}); make room "
                "or bring the directory back, it is tried again"
            )
            return False
        except Exception as error:  # the guard of this thread: a record that no column fits
            self._lost += len(self._queue)
            self._queue.clear()
            self._report(f"ticks cannot be archived in {self._directory} ({error!r})")
            return False
        if self._problem:
            self._problem = ""
            if self._on_resumed is not None:
                self._on_resumed(self._refused + self._lost)
        return True

    def _tidy(self) -> bool:
        """Do a small step of the rest; False if there is nothing to do."""
        try:
            return self._recorder.tidy()
        except (OSError, RuntimeError, KeyError) as error:
            self._tell(f"a segment of {self._directory} cannot be compressed ({error}); it stays")
            return True

    def _report(self, problem: str) -> None:
        if not self._problem:
            self._tell(problem)
        self._problem = problem

    def _tell(self, problem: str) -> None:
        if self._on_error is not None:
            self._on_error(ArchiveError(problem))

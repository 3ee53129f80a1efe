"""What the archive's thread does, one call at a time: fill segments, compress and remove them."""

import fcntl
import os
import uuid
from collections import deque
from collections.abc import Generator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import IO

from orbitfb.core.errors import ArchiveError, OwnershipError
from orbitfb.core.files.state import make_directory, open_to_append
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Channels, TickRecord
from orbitfb.history.columns import allocate, fill, layout, row_bytes
from orbitfb.history.segment import UNFINISHED, RawSegment, compressing
from orbitfb.history.settings import ArchiveSettings

_MOST_AT_ONCE = 200


class Recorder:
    """The only writer of a directory of segments. One thread may use it.

    Args:
        directory: Where the segments lie; it is made if its parent is there.
        channels: The names behind the vectors.
        settings: Sizes and times.
        clock: Gives the names of the segments and their age.

    Raises:
        ArchiveError: The directory cannot be used.
        OwnershipError: Another writer uses it.
    """

    def __init__(
        self, directory: Path, channels: Channels, settings: ArchiveSettings, clock: Clock
    ) -> None:
        self._directory = directory
        self._channels = channels
        self._settings = settings
        self._clock = clock
        self._run = uuid.uuid4().hex
        self._auxiliary: dict[str, None] = {}
        self._segment: RawSegment | None = None
        self._born = 0.0
        self._named = datetime.min.replace(tzinfo=UTC)
        self._tidying: Generator[None] | None = None
        try:
            make_directory(directory)
            self._lock = self._take_directory()
            left = sorted(directory.glob("*.h5"))
        except OSError as error:
            raise ArchiveError(
                f"the archive {directory} cannot be used ({error.strerror}); name another "
                "directory or repair its permissions"
            ) from error
        # Segments of runs that were killed wait here for compression like full ones.
        self._full = deque(left if settings.compress else ())

    @property
    def path(self) -> Path | None:
        """The segment that is being filled."""
        return None if self._segment is None else self._segment.path

    def write(self, records: deque[TickRecord]) -> int:
        """Put records on disk, taking each off the queue once it is there.

        At most a few hundred at a time, so that a backlog does not keep the caller.

        Returns:
            How many were written.

        Raises:
            OSError: The disk refuses; what is still in the queue is not written, and the next
                call begins a new segment.
        """
        batch = [records[row] for row in range(min(len(records), _MOST_AT_ONCE))]
        if not batch:
            return 0
        names = {name for r in batch if r.reading is not None for name in r.reading.auxiliary}
        if not names <= self._auxiliary.keys():
            self._auxiliary |= dict.fromkeys(sorted(names))
            self._finish()
        try:
            segment = self._current()
            batch = batch[: segment.rows - segment.used]
            columns = allocate(segment.plan, len(batch))
            for row, record in enumerate(batch):
                fill(columns, row, record)
            segment.append(columns, 0, len(batch))
        except (OSError, RuntimeError):
            self._finish()
            raise
        for _ in batch:
            records.popleft()
        if segment.used == segment.rows:
            self._finish()
        return len(batch)

    def tidy(self) -> bool:
        """Do one small step of compressing full segments and of removing old ones.

        Returns:
            Whether there is more to do.

        Raises:
            OSError: A segment cannot be rewritten; it stays as it is and is left alone.
        """
        if self._tidying is None:
            if not self._full:
                return False
            path = self._full.popleft()
            if not path.exists():  # retention was faster
                return True
            self._tidying = compressing(path)
        try:
            next(self._tidying)
        except StopIteration:
            self._tidying = None
            self._remove_oldest()
        except (OSError, RuntimeError, KeyError):
            self._tidying = None
            raise
        return True

    def close(self) -> None:
        """Let go of the segment and the directory."""
        if self._tidying is not None:
            self._tidying.close()
        if self._segment is not None:
            self._segment.close()
            self._segment = None
        self._lock.close()

    def _current(self) -> RawSegment:
        age = self._clock.monotonic() - self._born
        if self._segment is not None and age > 60.0 * self._settings.segment_minutes:
            self._finish()
        if self._segment is None:
            plan = layout(self._channels, self._auxiliary)
            rows = max(1, int(1e6 * self._settings.segment_megabytes) // row_bytes(plan))
            if os.fstat(self._lock.fileno()).st_nlink == 0:  # somebody removed the directory
                make_directory(self._directory)
                self._lock.close()
                self._lock = self._take_directory()
            self._born = self._clock.monotonic()
            self._segment = RawSegment(self._next_path(), self._channels, plan, rows, self._run)
            self._remove_oldest()
        return self._segment

    def _take_directory(self) -> IO[str]:
        """Lock the directory and sweep away what a killed writer left unfinished."""
        lock = open_to_append(self._directory / ".writer")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            lock.close()
            raise OwnershipError(
                f"another process writes the archive {self._directory}; stop it or name another "
                "directory"
            ) from error
        for left in self._directory.glob(f"{UNFINISHED}*"):
            left.unlink()
        return lock

    def _finish(self) -> None:
        """Close the segment; a new one is begun when there is something to write."""
        if self._segment is None:
            return
        self._segment.close()
        if self._settings.compress:
            self._full.append(self._segment.path)
        self._segment = None

    def _next_path(self) -> Path:
        # Names must sort in the order of writing even when the wall clock steps back.
        step = timedelta(microseconds=1)
        now = datetime.fromtimestamp(self._clock.wall(), UTC)
        self._named = max(now, self._named + step)
        while (path := self._directory / f"orbit-{self._named:%Y%m%dT%H%M%S.%fZ}.h5").exists():
            self._named += step
        return path

    def _remove_oldest(self) -> None:
        if self._settings.keep_gigabytes is None:
            return
        sizes = {path: 512 * path.stat().st_blocks for path in self._directory.glob("*.h5")}
        excess = sum(sizes.values()) - 1e9 * self._settings.keep_gigabytes
        for path in sorted(sizes):
            if excess <= 0.0 or path == self.path:
                break
            path.unlink()
            excess -= sizes[path]

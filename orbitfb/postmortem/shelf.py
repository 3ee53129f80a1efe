"""The directory of the post-mortems: a file is there as a whole or not at all."""

import uuid
from datetime import UTC, datetime, timedelta
from pathlib import Path

from orbitfb.core.files.state import make_directory, sync_directory, write_through

PREFIX, SUFFIX = "postmortem-", ".h5"
UNFINISHED = ".unfinished-"
"""What the names of files begin with that never became a post-mortem."""


class Shelf:
    """The only writer of a directory of post-mortems.

    Args:
        directory: Where they lie; it is made when there is one to write.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self._named = datetime.min.replace(tzinfo=UTC)

    def put(self, wall: float, content: bytes | memoryview) -> Path:
        """Write a file and give its name.

        Args:
            wall: When the trip was [s since the epoch].
            content: Of the file.

        Raises:
            OSError: The disk refuses; nothing is left behind.
        """
        make_directory(self.directory)
        unfinished = self.directory / f"{UNFINISHED}{uuid.uuid4().hex}"
        try:
            write_through(unfinished, content)
            path = self._next_path(wall)
            unfinished.rename(path)
        finally:
            unfinished.unlink(missing_ok=True)
        sync_directory(self.directory)
        return path

    def sweep(self) -> None:
        """Remove what a killed writer left unfinished.

        Raises:
            OSError: It cannot be removed.
        """
        for left in self.directory.glob(f"{UNFINISHED}*"):
            left.unlink(missing_ok=True)

    def trim(self, files: int, size: float) -> list[Path]:
        """Remove the oldest files beyond a number and a size; the newest stays.

        Args:
            files: How many are kept.
            size: Of all together [bytes].

        Returns:
            What was removed.

        Raises:
            OSError: One cannot be removed.
        """
        found = stored(self.directory)
        left = sum(path.stat().st_size for path in found)
        removed: list[Path] = []
        for position, path in enumerate(found[:-1]):
            if len(found) - position <= files and left <= size:
                break
            left -= path.stat().st_size
            path.unlink()
            removed.append(path)
        return removed

    def _next_path(self, wall: float) -> Path:
        # Names must sort in the order of writing even when the wall clock steps back.
        step = timedelta(microseconds=1)
        self._named = max(datetime.fromtimestamp(wall, UTC), self._named + step)
        while (path := self.directory / _name(self._named)).exists():
            self._named += step
        return path


def _name(moment: datetime) -> str:
    return f"{PREFIX}{moment:%Y%m%dT%H%M%S.%fZ}{SUFFIX}"


def stored(directory: Path) -> list[Path]:
    """List the post-mortems of a directory, the oldest first; none if there is no directory."""
    return sorted(path for path in directory.glob(f"{PREFIX}*{SUFFIX}") if path.is_file())

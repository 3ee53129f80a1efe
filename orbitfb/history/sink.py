"""A file for HDF5 to write to that never fails in its hands.

HDF5 does not survive a file that it cannot write: when its last flush fails, a full disk for one,
what is left of the file stays half closed within the library, and a later close of any other file
may end the whole process (seen with HDF5 2.0.0: a segmentation fault). So HDF5 is given a file of
Python's, whose writes always succeed: what the disk refuses is kept in memory, that HDF5 can read
it back and close, and the trouble is told afterwards, when HDF5 is done.
"""

import io
import os
from pathlib import Path
from typing import Any

from orbitfb.core.files.state import NEW, OWN

_PAGE = 4096


class Sink(io.RawIOBase):
    """A new file on disk; what the disk refuses stays in memory.

    Whoever writes much asks `check` now and then: from the first trouble on all goes to memory.

    Args:
        path: Its name; there must be no such file.

    Attributes:
        descriptor: Of the file on disk; `close_descriptor` lets go of it.

    Raises:
        OSError: It cannot be made.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.descriptor = os.open(path, NEW, OWN)
        self._position = self._size = 0
        self._trouble: OSError | None = None
        self._kept: dict[int, bytearray] = {}

    def check(self) -> None:
        """Tell whether all that was written is in the file.

        Raises:
            OSError: The first thing that the disk refused.
        """
        if self._trouble is not None:
            raise self._trouble

    def close_descriptor(self) -> None:
        """Let go of the file on disk."""
        os.close(self.descriptor)

    def readable(self) -> bool:
        """Say that it can be read."""
        return True

    def writable(self) -> bool:
        """Say that it can be written."""
        return True

    def seekable(self) -> bool:
        """Say that it has positions."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET, /) -> int:
        """Go to a position [bytes].

        Args:
            offset: Where to.
            whence: From where it counts.
        """
        origin = {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._size}
        self._position = max(0, origin[whence] + offset)
        return self._position

    def truncate(self, size: int | None = None, /) -> int:
        """Set the size; what is added reads as 0.

        Args:
            size: The new one [bytes]; by default up to the position.
        """
        self._size = self._position if size is None else size
        if self._trouble is None:
            try:
                os.ftruncate(self.descriptor, self._size)
            except OSError as error:
                self._trouble = error
        return self._size

    def write(self, data: Any, /) -> int:
        """Write at the position; never fails.

        Args:
            data: Bytes.
        """
        view = memoryview(data).cast("B")
        if self._trouble is None:
            try:
                write_all(self.descriptor, view, self._position)
            except OSError as error:
                self._trouble = error
        if self._trouble is not None:
            self._keep(view)
        self._position += len(view)
        self._size = max(self._size, self._position)
        return len(view)

    def readinto(self, buffer: Any, /) -> int:
        """Read from the position.

        Args:
            buffer: Where to.
        """
        view = memoryview(buffer).cast("B")
        count = max(0, min(len(view), self._size - self._position))
        view[:count] = self._stored(self._position, count)
        done = 0
        while self._kept and done < count:
            page, start = divmod(self._position + done, _PAGE)
            length = min(_PAGE - start, count - done)
            if page in self._kept:
                view[done : done + length] = self._kept[page][start : start + length]
            done += length
        self._position += count
        return count

    def _keep(self, view: memoryview) -> None:
        done = 0
        while done < len(view):
            page, start = divmod(self._position + done, _PAGE)
            length = min(_PAGE - start, len(view) - done)
            if page not in self._kept:
                self._kept[page] = bytearray(self._stored(page * _PAGE, _PAGE))
            self._kept[page][start : start + length] = view[done : done + length]
            done += length

    def _stored(self, position: int, count: int) -> bytes:
        """Read from the disk; what is not there reads as 0."""
        parts, left = list[bytes](), count
        try:
            while left and (part := os.pread(self.descriptor, left, position + count - left)):
                parts.append(part)
                left -= len(part)
        except OSError as error:
            self._trouble = self._trouble or error
        return b"".join(parts) + bytes(left)


def write_all(descriptor: int, view: memoryview, position: int) -> None:
    """Write bytes at a position of a file.

    Args:
        descriptor: Of the file.
        view: The bytes.
        position: Where to [bytes].

    Raises:
        OSError: Not all of them could be written.
    """
    while view:
        written = os.pwrite(descriptor, view, position)
        view, position = view[written:], position + written

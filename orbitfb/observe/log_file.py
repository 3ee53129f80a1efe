"""The file of the log, that a full disk or a removed directory keeps waiting and does not lose."""

import errno
import logging
import os
import sys
from collections import deque
from contextlib import suppress
from io import TextIOWrapper
from logging.handlers import RotatingFileHandler
from pathlib import Path
from typing import cast

import structlog

from orbitfb.core.files.state import make_directory, open_to_append

_WAITING = 2000


class LogFile(RotatingFileHandler):
    """Write whole lines, or none; those that the disk refuses wait for the next event.

    Args:
        path: The file; its directory is made again if somebody removes it.
        largest: A new file is begun at this size [bytes].
        kept: How many old ones are kept.

    Raises:
        OSError: It cannot be opened.
    """

    def __init__(self, path: Path, largest: int, kept: int) -> None:
        super().__init__(path, maxBytes=largest, backupCount=kept, encoding="utf-8", delay=True)
        self._waiting: deque[bytes] = deque()
        self._lost = 0
        self._refused = ""
        self.stream = self._opened()

    def emit(self, record: logging.LogRecord) -> None:
        """Write a line, after those that wait."""
        try:
            line = self.format(record).encode() + b"\n"
        except Exception:  # the guard of a handler: an event that cannot be written as text
            self.handleError(record)
            return
        if len(self._waiting) < _WAITING:
            self._waiting.append(line)
        else:
            self._lost += 1
        self._drain()

    def close(self) -> None:
        """Try once more, and let go of the file."""
        self._drain()
        super().close()

    def _opened(self) -> TextIOWrapper:
        """Open it for this user alone; a link of that name is not followed."""
        return cast(TextIOWrapper, open_to_append(Path(self.baseFilename)))

    def _drain(self) -> None:
        try:
            while self._waiting:
                self._write(self._waiting[0])
                self._waiting.popleft()
        except OSError as error:
            if not self._refused:
                self._refused = f"{error.strerror or error}"
                told = (
                    f"the log {self.baseFilename} cannot be written ({self._refused}): lines wait"
                )
                with suppress(OSError, ValueError):
                    sys.stderr.write(f"orbitfb: {told}\n")
            return
        if self._refused:
            problem, lost, self._refused, self._lost = self._refused, self._lost, "", 0
            log = structlog.stdlib.get_logger("orbitfb.service")
            log.warning("log_resumed", problem=problem, lost=lost)

    def _write(self, line: bytes) -> None:
        descriptor = self._descriptor()
        size = os.fstat(descriptor).st_size
        if size and self.maxBytes and size + len(line) > self.maxBytes:
            self.doRollover()
            descriptor, size = self._descriptor(), 0
        try:
            if os.write(descriptor, line) < len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            os.ftruncate(descriptor, size)  # no half of a line stays
            raise

    def _descriptor(self) -> int:
        """Open the file anew if somebody took it away."""
        stream, path = self.stream, Path(self.baseFilename)
        if stream is not None:
            with suppress(FileNotFoundError):
                if os.path.samestat(path.stat(), os.fstat(stream.fileno())):
                    return stream.fileno()
            stream.close()
        make_directory(path.parent)
        stream = self.stream = self._opened()
        return stream.fileno()

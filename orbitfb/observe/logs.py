"""The JSON log: one object per line, written by a thread of its own."""

import logging
import sys
from collections.abc import MutableMapping
from logging.handlers import QueueHandler, QueueListener
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import structlog

from orbitfb.core.errors import OwnershipError
from orbitfb.core.files.state import make_directory
from orbitfb.observe.log_file import LogFile
from orbitfb.observe.plain import dumps
from orbitfb.observe.settings import LogSettings


class Logs:
    """The log while it is written; `close` puts everything back as it was.

    Args:
        handlers: Where the lines go.
        level: Least severe level of our own events.
    """

    def __init__(self, handlers: list[logging.Handler], level: int) -> None:
        # An event is only put in a queue by the thread that has something to say: a disk that
        # stalls must not stall the loop. Events are rare, so the queue needs no bound.
        self._handlers = handlers
        queue: SimpleQueue[logging.LogRecord] = SimpleQueue()
        self._entrance = _Entrance(queue)
        self._listener = QueueListener(queue, *handlers)
        root, ours = logging.getLogger(), logging.getLogger("orbitfb")
        self._old_levels = root.level, ours.level
        root.addHandler(self._entrance)
        root.setLevel(logging.WARNING)
        ours.setLevel(level)
        self._listener.start()
        self._closed = False

    def close(self) -> None:
        """Write what is still queued and let go of the files. May be called twice."""
        if self._closed:
            return
        self._closed = True
        root, ours = logging.getLogger(), logging.getLogger("orbitfb")
        root.removeHandler(self._entrance)
        root.setLevel(self._old_levels[0])
        ours.setLevel(self._old_levels[1])
        self._listener.stop()
        for handler in self._handlers:
            handler.close()
        structlog.reset_defaults()


def log_is_open() -> bool:
    """Whether events go to a log of this process; else nobody has said where."""
    return any(isinstance(one, _Entrance) for one in logging.getLogger().handlers)


class _Entrance(QueueHandler):
    """Queue records as they are; they do not leave the process, so nothing is rendered yet."""

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        """Leave the record untouched."""
        return record


def configure_logs(settings: LogSettings, directory: Path) -> Logs:
    """Send structlog events, and warnings of libraries, as JSON lines to where settings say.

    Args:
        settings: File, stderr, level, sizes.
        directory: What a relative file name is relative to.

    Raises:
        OwnershipError: The file cannot be opened.
    """
    shared: list[Any] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.add_log_level,
        structlog.stdlib.ExtraAdder(),
        structlog.processors.TimeStamper(fmt="iso", utc=True),
    ]
    formatter = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.format_exc_info,
            _order,
            structlog.processors.JSONRenderer(serializer=_serialize),
        ],
    )
    handlers: list[logging.Handler] = []
    if settings.file:
        handlers.append(_file(settings, directory / settings.file))
    if settings.stderr:
        handlers.append(logging.StreamHandler(sys.stderr))
    for handler in handlers:
        handler.setFormatter(formatter)
    logs = Logs(handlers, logging.getLevelNamesMapping()[settings.level.upper()])
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared,
            structlog.processors.StackInfoRenderer(),
            structlog.processors.format_exc_info,  # here: only this thread knows the exception
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
        cache_logger_on_first_use=False,
    )
    return logs


def _file(settings: LogSettings, path: Path) -> LogFile:
    try:
        make_directory(path.parent)
        return LogFile(path, settings.largest, settings.kept)
    except OSError as error:
        raise OwnershipError(
            f"the log cannot be written to {path}: {error.strerror}; "
            "set observe.logs.file to a file that can be written to, or to '' for none"
        ) from error


def _order(
    _logger: object, _method: str, event: MutableMapping[str, Any]
) -> MutableMapping[str, Any]:
    """Put time, level and name of the event first, for people who read the file."""
    first = {key: event.pop(key) for key in ("timestamp", "level", "event") if key in event}
    return {**first, **event}


def _serialize(event: Any, **_options: Any) -> str:
    return dumps(event)

"""Events of the log on their way to a recorder of post-mortems."""

import logging
from collections.abc import Callable
from typing import Any


class LogTap(logging.Handler):
    """Hands every event of the log to a recorder, with the thread that had something to say.

    Args:
        tell: Takes level, name and fields.
    """

    def __init__(self, tell: Callable[[str, str, dict[str, Any]], None]) -> None:
        super().__init__()
        self._tell = tell
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Take a line; one of a library has no fields."""
        level = record.levelname.lower()
        if isinstance(record.msg, dict):
            fields = dict(record.msg)
            for name in ("level", "timestamp", "_record", "_from_structlog"):
                fields.pop(name, None)
            self._tell(level, str(fields.pop("event", "")), fields)
        else:
            self._tell(level, record.name, {"message": record.getMessage()})

    def close(self) -> None:
        """Listen no longer."""
        logging.getLogger().removeHandler(self)
        super().close()

"""Read files of others: never more than is expected, and every way to be no JSON or TOML is known.

A parser raises more than its own error over a hostile text: ValueError for a number of ten
thousand digits, RecursionError for brackets a hundred thousand deep. Here both are a refusal.
"""

import json
import tomllib
from pathlib import Path
from typing import Any

from orbitfb.core.errors import OrbitFeedbackError

LARGEST_TEXT = 1 << 24
"""Longest text that people write or edit: a configuration, a table of places [bytes]."""


def read_bytes(path: Path, largest: int, refuse: type[OrbitFeedbackError], advice: str) -> bytes:
    """Read a file, but never more than is expected; also from what has no end.

    Args:
        path: The file.
        largest: Largest size that is read [bytes].
        refuse: Error to raise.
        advice: What to do then.
    """
    try:
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise refuse(f"{path}: cannot be read ({reason}); {advice}") from error
    if len(content) > largest:
        raise refuse(
            f"{path}: is longer than {largest} bytes, which are the most that are read; {advice}"
        )
    return content


def read_text(path: Path, largest: int, refuse: type[OrbitFeedbackError], advice: str) -> str:
    """Read a text in UTF-8, but never more than is expected.

    Args:
        path: The file.
        largest: Largest size that is read [bytes].
        refuse: Error to raise.
        advice: What to do then.
    """
    content = read_bytes(path, largest, refuse, advice)
    try:
        return content.decode()
    except UnicodeDecodeError as error:
        raise refuse(f"{path}: not UTF-8 text at byte {error.start}; save it as UTF-8") from error


def parse_toml(text: str, source: object, refuse: type[OrbitFeedbackError]) -> dict[str, Any]:
    """Parse TOML.

    Args:
        text: The document.
        source: Name of the file, for the message.
        refuse: Error to raise.
    """
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse(f"{source}: is not TOML: {_why(error)}") from error


def parse_json(text: str | bytes, source: object, refuse: type[OrbitFeedbackError]) -> Any:
    """Parse JSON.

    Args:
        text: The document.
        source: Name of the file, for the message.
        refuse: Error to raise.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise refuse(
            f"{source}, line {error.lineno}: not JSON ({error.msg}); correct the file"
        ) from error
    except (ValueError, RecursionError) as error:
        raise refuse(f"{source}: not JSON that is read ({_why(error)}); correct the file") from (
            error
        )


def _why(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error)

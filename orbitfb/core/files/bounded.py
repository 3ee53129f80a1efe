"""Read files of others: never more than is expected, and every way to be no JSON or TOML is known.

A parser raises more than its own error over a hostile text: ValueError for a number of ten
thousand digits, RecursionError for brackets a hundred thousand deep. Here both are a refusal.
"""

import json
import re
import tomllib
from pathlib import Path
from typing import IO, Any, cast

from orbitfb.core.errors import OrbitFeedbackError

LARGEST_TEXT = 1 << 22
"""Longest text that people write or edit: a configuration, a table of places [bytes]."""

LARGEST_DIAGNOSIS = 1 << 24
"""Longest `diagnosis.json` that is read, by whoever reads one [bytes]."""

DEEPEST = 32
"""Most levels of tables, objects and lists within each other."""

_PIECE = 1 << 20
_LONGEST_LINE = 100_000
_PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+"""
_DEEP_KEY = re.compile(rf"""(?<![\w"'-])(?:{_PART}\.[ \t]*+){{{DEEPEST}}}""")


def take(file: IO[bytes], most: int) -> bytes:
    """Take at most so many bytes of a file, without making room for more than there are."""
    parts: list[bytes] = []
    while most > 0 and (part := file.read(min(most, _PIECE))):
        parts.append(part)
        most -= len(part)
    return b"".join(parts)


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
            content = take(file, largest + 1)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        reason = error.strerror if isinstance(error, OSError) else error
        raise refuse(f"{path}: cannot be read ({reason}); {advice}") from error
    if len(content) > largest:
        raise refuse(
            f"{path}: is longer than {largest} bytes, which are the most that are read; {advice}"
        )
    return content


def read_text(path: Path, largest: int, refuse: type[OrbitFeedbackError], advice: str) -> str:
    """Read a text in UTF-8, with a byte order mark or without, but never more than is expected.

    Args:
        path: The file.
        largest: Largest size that is read [bytes].
        refuse: Error to raise.
        advice: What to do then.
    """
    content = read_bytes(path, largest, refuse, advice)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise refuse(f"{path}: not UTF-8 text at byte {error.start}; save it as UTF-8") from error


def parse_toml(text: str, source: object, refuse: type[OrbitFeedbackError]) -> dict[str, Any]:
    """Parse TOML.

    Args:
        text: The document.
        source: Name of the file, for the message.
        refuse: Error to raise.
    """
    # tomllib needs time with the square of the parts of a key
    if _DEEP_KEY.search(text) or max(map(len, text.splitlines()), default=0) > _LONGEST_LINE:
        raise refuse(
            f"{source}: is not TOML that is read: keys of at most {DEEPEST} parts, lines of at "
            f"most {_LONGEST_LINE} characters are"
        )
    try:
        tree = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise refuse(f"{source}: is not TOML: {_why(error)}") from error
    if _depth(tree) > DEEPEST:
        raise refuse(f"{source}: is not TOML that is read: nested too deeply")
    return tree


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


def _depth(tree: Any) -> int:
    """Count levels, without descending into them one call for each."""
    depth, level = 0, [tree]
    while level:
        depth += 1
        level = [
            inner
            for outer in level
            if isinstance(outer, (dict, list))
            for inner in cast(
                "list[Any]", list(outer.values()) if isinstance(outer, dict) else outer
            )
        ]
    return depth


def _why(error: Exception) -> str:
    return "nested too deeply" if isinstance(error, RecursionError) else str(error)

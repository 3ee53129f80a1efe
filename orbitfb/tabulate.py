"""Answers of the program as text for people: one name and value per line."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any


def as_text(answer: Mapping[str, Any]) -> str:
    """Write an answer, nested parts indented below their name; what is empty is left out.

    Args:
        answer: Made of what JSON knows; `time` is in seconds since the epoch.
    """
    return "\n".join(_lines(answer, ""))


def as_json(answer: Any) -> str:
    """Write an answer as JSON."""
    return json.dumps(answer, indent=2, allow_nan=False)


def _lines(answer: Mapping[str, Any], indent: str) -> Iterator[str]:
    shown = {name: value for name, value in answer.items() if value not in ("", {})}
    width = max((len(name) for name, value in shown.items() if not _nested(value)), default=0)
    for name, value in shown.items():
        if isinstance(value, Mapping):
            yield f"{indent}{name}:"
            yield from _lines(value, f"{indent}  ")
        else:
            yield f"{indent}{name:<{width}}  {_plain(name, value)}"


def _nested(value: Any) -> bool:
    return isinstance(value, Mapping)


def _plain(name: str, value: Any) -> str:
    if value is None:
        return "-"
    if name == "time" and isinstance(value, float):
        return datetime.fromtimestamp(value).astimezone().isoformat(sep=" ", timespec="seconds")
    return f"{value:.6g}" if isinstance(value, float) else str(value)

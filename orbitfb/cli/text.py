"""Answers of the program as text for people: one name and value per line."""

import json
from collections.abc import Iterator, Mapping
from datetime import datetime
from typing import Any

_MICROMETRES, _MILLIAMPERES, _SECONDS = (1e6, "µm"), (1e3, "mA"), (1.0, "s")
UNITS: Mapping[str, tuple[float, str]] = {
    **dict.fromkeys(
        (
            *("before_floor", "after_floor", "before_worst", "after_worst", "spread"),
            *("predicted_rms_candidate", "predicted_rms_incumbent", "reading_noise", "ground"),
            *("shadow_rms_candidate", "shadow_rms_incumbent", "rms_before", "unreachable_rms"),
        ),
        _MICROMETRES,
    ),
    **dict.fromkeys(("change_rms", "shadow_change_rms"), _MILLIAMPERES),
    **dict.fromkeys(("seconds", "seconds_per_iteration", "duration"), _SECONDS),
}
"""Figures that have a unit: what one of it in SI is there, and its name; JSON stays SI."""


def as_text(answer: Mapping[str, Any]) -> str:
    """Write an answer, nested parts indented below their name; what is empty is left out.

    Args:
        answer: Made of what JSON knows; `time` is in seconds since the epoch, the figures that
            `UNITS` names are SI.
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
    if name in UNITS and isinstance(value, float):
        scale, unit = UNITS[name]
        return f"{value * scale:.4g} {unit}"
    return f"{value:.6g}" if isinstance(value, float) else str(value)

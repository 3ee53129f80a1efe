"""What a check of a record found."""

from dataclasses import dataclass
from typing import Literal

Severity = Literal["note", "warning", "failure"]


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that is wrong, or worth knowing, about a record.

    Args:
        check: The check that found it, kebab-case.
        severity: `note`: good to know, or for the tournament to decide; `warning`: something is
            broken, and the diagnosis goes on; `failure`: a diagnosis would be nonsense.
        devices: Names of the devices concerned, with their plane; empty: all of them or none.
        rows: First and last row of the record concerned; None: all of them.
        text: What it is and what to do, a sentence or two.
        effect: Id of the effect that it proves; empty when it proves none.
    """

    check: str
    severity: Severity
    devices: tuple[str, ...]
    rows: tuple[int, int] | None
    text: str
    effect: str = ""


def listed(names: list[str] | tuple[str, ...], most: int = 5) -> str:
    """Write names in a row, not more than some."""
    shown = ", ".join(names[:most])
    return shown if len(names) <= most else f"{shown} and {len(names) - most} more"


def counted(number: int, what: str) -> str:
    """Write a number with what it counts, in the plural where it is not one: `1 row`, `2 rows`."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"

"""One PV of the panel, as a value."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any

Range = tuple[float, float]
NO_RANGE: Range = (0.0, 0.0)
"""Equal ends mean no limit, as in EPICS."""

LONGEST_TEXT = 4000
"""Longest text that a PV shows or takes [characters]."""


class Severity(IntEnum):
    """How bad a value is, as Channel Access counts it."""

    NONE = 0
    MINOR = 1
    MAJOR = 2


class Kind(StrEnum):
    """What a PV holds."""

    DOUBLE = "double"
    INTEGER = "integer"
    CHOICE = "enum"
    TEXT = "text"
    DOUBLES = "doubles"
    SWITCHES = "integers"
    NAMES = "names"


VECTORS = (Kind.DOUBLES, Kind.SWITCHES, Kind.NAMES)
"""Kinds that hold an element for each device or mode."""


@dataclass(frozen=True, slots=True)
class Order:
    """What a write to a PV asks of the service.

    Args:
        command: Name of the command.
        key: Under which the value goes with it; empty: the value is not told.
        scale: What the command gets is scale × the number of the PV.
        choices: For a choice: the request of each state; None: nothing is done.
        more: What else goes with it.
    """

    command: str
    key: str = ""
    scale: float = 1.0
    choices: tuple[Mapping[str, Any] | None, ...] = ()
    more: tuple[tuple[str, Any], ...] = ()


@dataclass(frozen=True, slots=True)
class PanelPv:
    """One PV.

    Args:
        name: Without the prefix.
        kind: What it holds.
        meaning: In one sentence.
        units: At most 7 characters.
        precision: Digits after the point on a screen.
        limits: Range outside which a write is refused, for every element.
        states: Words of a choice.
        length: Elements of a vector.
        order: What a write does; None: it cannot be written.
        minor: Words of a choice that are a MINOR alarm.
        major: Words of a choice that are a MAJOR alarm.
        high: A number from which on it is a MINOR alarm.
        along: PV of what a plot of a vector has on its other axis; empty: the index.
    """

    name: str
    kind: Kind
    meaning: str
    units: str = ""
    precision: int = 0
    limits: Range = NO_RANGE
    states: tuple[str, ...] = ()
    length: int = 1
    order: Order | None = None
    minor: tuple[str, ...] = ()
    major: tuple[str, ...] = ()
    high: float = math.inf
    along: str = ""

    @property
    def alarms(self) -> bool:
        """Whether a value that is known can be an alarm."""
        return bool(self.minor or self.major or self.high < math.inf)

    def severity(self, value: Any) -> Severity:
        """Say how bad a value is: a word of a choice, or a number."""
        if self.kind is Kind.CHOICE:
            return (
                Severity.MAJOR
                if value in self.major
                else Severity.MINOR
                if value in self.minor
                else Severity.NONE
            )
        return Severity.MINOR if self.high < math.inf and value >= self.high else Severity.NONE

    @property
    def writable(self) -> bool:
        """Whether clients may write it at all."""
        return self.order is not None


def request_of(pv: PanelPv, value: Any) -> dict[str, Any] | None:
    """Turn what was written into a request to the service; None: there is nothing to do.

    Args:
        pv: A PV that can be written.
        value: Checked: a number, a word, the index of a choice, or a sequence of numbers.
    """
    order = pv.order
    if order is None:
        return None
    if order.choices:
        chosen = order.choices[value]
        return None if chosen is None else dict(chosen)
    request: dict[str, Any] = {"command": order.command, **dict(order.more)}
    if order.key:
        request[order.key] = _scaled(pv.kind, value, order.scale)
    return request


def _scaled(kind: Kind, value: Any, scale: float) -> Any:
    match kind:
        case Kind.DOUBLE:
            return float(value) * scale
        case Kind.INTEGER:
            return int(value)
        case Kind.DOUBLES:
            return [float(element) * scale for element in value]
        case Kind.SWITCHES:
            return [bool(element) for element in value]
        case _:
            return str(value)


def out_of_range(pv: PanelPv, value: float | Sequence[float]) -> str:
    """Say what is wrong with a number or a vector of them; empty when nothing is.

    Args:
        pv: Has the limits and the length.
        value: In the units of the PV.
    """
    vector = pv.kind in VECTORS
    elements = list(value) if isinstance(value, Sequence) else [value]
    if len(elements) != pv.length:
        return f"{pv.name} takes {pv.length} numbers, not {len(elements)}"
    low, high = pv.limits
    for index, element in enumerate(elements):
        # a comparison with NaN is false
        if not (low <= element <= high if low != high else element - element == 0):
            where = f"element {index} of {pv.name}" if vector else pv.name
            units = f" {pv.units}" if pv.units else ""
            return f"{where}: {element:g} is not from {low:g} to {high:g}{units}"
    return ""

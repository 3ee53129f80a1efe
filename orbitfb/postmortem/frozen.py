"""What is frozen of a trip, before it goes to a file."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from orbitfb.core.signals import LoopState, TickRecord


class Trigger(StrEnum):
    """Why a post-mortem was made."""

    TRIP = "trip"
    """The loop went into TRIPPED."""
    FAULT = "fault"
    """The program itself failed."""
    COMMAND = "command"
    """An operator asked for it."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One tick as it was taken.

    Args:
        monotonic: When it had ended [s].
        wall: The same [s since the epoch].
        record: What it left behind.
    """

    monotonic: float
    wall: float
    record: TickRecord


@dataclass(frozen=True, slots=True)
class Event:
    """Something that was logged: a command, a refit, a swap, an alarm, trouble with a file.

    Args:
        monotonic: When [s].
        wall: The same [s since the epoch].
        level: Of the log, as `warning`.
        name: One word, as `refit_judged`.
        fields: What else the log says of it.
    """

    monotonic: float
    wall: float
    level: str
    name: str
    fields: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class Cause:
    """The moment that a post-mortem is about.

    Args:
        trigger: Why it was made.
        monotonic: When the tick had ended [s]; for a command, when it came.
        wall: The same [s since the epoch].
        tick: Which tick; the last one before a command, -1 if there was none.
        state: State of the loop then.
        before: State of the tick before; None if there was none.
        reason: Why it is in that state; for a command, who asked.
    """

    trigger: Trigger
    monotonic: float
    wall: float
    tick: int
    state: LoopState | None
    before: LoopState | None
    reason: str


@dataclass(frozen=True, slots=True)
class Frozen:
    """What was known at a trip.

    Args:
        cause: What it is about.
        ticks: Ticks of the time that is kept, the oldest first.
        events: Events of the same time.
    """

    cause: Cause
    ticks: tuple[Tick, ...]
    events: tuple[Event, ...]

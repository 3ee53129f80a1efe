"""The state table: (state, event) -> state, as data. What is not in it has a named refusal."""

from collections.abc import Mapping
from enum import StrEnum

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState


class Event(StrEnum):
    """What can happen to the loop: four commands and six things of its own."""

    OPEN = "open"
    SHADOW = "shadow"
    CLOSE = "close"
    RESET = "reset"
    ORBIT_MISSING = "orbit_missing"
    HOLD = "hold"
    TRIP = "trip"
    RECOVERED = "recovered"
    HELD_TOO_LONG = "held_too_long"
    FAULT = "fault"


COMMANDS = frozenset({Event.OPEN, Event.SHADOW, Event.CLOSE, Event.RESET})
"""The events that come from an operator; the others come from the loop itself."""

_OPEN, _SHADOW, _CLOSED = LoopState.OPEN, LoopState.SHADOW, LoopState.CLOSED
_HELD, _TRIPPED, _FAULT = LoopState.HELD, LoopState.TRIPPED, LoopState.FAULT

_ORDERS = {Event.OPEN: _OPEN, Event.SHADOW: _SHADOW, Event.CLOSE: _CLOSED}


def _stays(state: LoopState, **leaves: LoopState) -> dict[Event, LoopState]:
    """Fill a row: the loop's own events leave the state alone unless told otherwise."""
    row = {event: state for event in Event if event not in COMMANDS}
    row.update({Event(name): after for name, after in leaves.items()})
    return row


TABLE: Mapping[LoopState, Mapping[Event, LoopState]] = {
    _OPEN: _stays(_OPEN, fault=_FAULT) | _ORDERS,
    _SHADOW: _stays(_SHADOW, fault=_FAULT) | _ORDERS,
    _CLOSED: _stays(_CLOSED, orbit_missing=_HELD, hold=_HELD, trip=_TRIPPED, fault=_FAULT)
    | _ORDERS,
    _HELD: _stays(_HELD, trip=_TRIPPED, recovered=_CLOSED, held_too_long=_TRIPPED, fault=_FAULT)
    | _ORDERS,
    _TRIPPED: _stays(_TRIPPED, fault=_FAULT) | {Event.RESET: _OPEN},
    _FAULT: _stays(_FAULT),
}
"""Every legal pair. Closing is subject to the interlocks besides."""


def next_state(state: LoopState, event: Event) -> LoopState:
    """Look a pair up.

    Args:
        state: Now.
        event: What happens.

    Raises:
        ControlError: The command is not legal in this state; says why and what to do.
    """
    after = TABLE[state].get(event)
    if after is None:
        raise ControlError(f"{event} refused in {state}: {_why_not(state)}")
    return after


def as_command(name: str) -> Event:
    """Turn the name of a command into its event.

    Args:
        name: `open`, `shadow`, `close` or `reset`.

    Raises:
        ControlError: There is no such command.
    """
    for event in COMMANDS:
        if event.value == name:
            return event
    known = ", ".join(event.value for event in Event if event in COMMANDS)
    raise ControlError(f"no command {name!r}: the loop knows {known}")


def _why_not(state: LoopState) -> str:
    if state is LoopState.TRIPPED:
        return "the loop tripped and stays open until reset; read the reason, then reset first"
    if state is LoopState.FAULT:
        return "the program failed; read the log and start it again"
    return "there is nothing to reset"

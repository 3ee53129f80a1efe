"""Waiting for the orbit that the next tick acts on."""

import math
import threading
from dataclasses import dataclass

from orbitfb.core.errors import MachineError
from orbitfb.core.ports import Clock, Machine
from orbitfb.core.signals import Reading
from orbitfb.loop.timing.pacing import Pace, see, slower

_SLICE = 0.5
_LEAST = 0.1


@dataclass(frozen=True, slots=True)
class Intake:
    """What the wait came to.

    Args:
        reading: The orbit for this tick; None when none came.
        absence: Why none came; empty when one did, or when the wait was ended early.
        pace: Stream of orbits as seen by then.
    """

    reading: Reading | None
    absence: str
    pace: Pace


def await_orbit(
    machine: Machine,
    clock: Clock,
    patience: float,
    pace: Pace,
    period: float,
    stop: threading.Event,
    sent: float = -math.inf,
) -> Intake:
    """Read until an orbit is due, passing over those that come faster than the loop ticks.

    One that was complete before the last change began to leave cannot know of it: a loop that is
    slower than its orbits would correct one error twice. It is passed over, too, and counts as
    missed. The wait is cut into slices, so that a slow loop still stops at once.

    Args:
        machine: To read.
        clock: The machine's and the loop's.
        patience: How long to wait [s].
        pace: Stream of orbits so far.
        period: Of the loop [s].
        stop: Ends the wait early.
        sent: When the last change began to leave, monotonic [s].
    """
    end = clock.monotonic() + patience
    slices = math.ceil(patience / _SLICE)
    while True:
        left = max(end - clock.monotonic(), _LEAST * period)
        try:
            reading = machine.read(min(left, _SLICE))
        except MachineError as error:
            slices -= 1
            if stop.is_set() and clock.monotonic() < end:
                return Intake(None, "", pace)  # none was due yet
            if left > _SLICE and slices > 0:
                continue
            told = filter(None, (str(error) or type(error).__name__, slower(pace, period)))
            return Intake(None, "; ".join(told), pace)
        is_due, pace = see(reading.orbit.time, pace, period)
        if is_due and reading.received >= sent:
            return Intake(reading, "", pace)

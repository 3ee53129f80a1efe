"""BPM that reads the stored current."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

CHANNEL = "current"
"""Auxiliary channel of the stored current [A]."""
FULL_CURRENT = 0.5
"""Stored current right after a top-up [A]."""
LOST_SHARE = 0.01
"""Share of it that is lost before the next one."""
TOP_UP_PERIOD = 60.0
"""From one top-up to the next [s]."""


def top_up_current(time: Vector) -> Vector:
    """Tell the stored current of a ring in top-up operation, a sawtooth.

    Args:
        time: Since the start, any shape [s].

    Returns:
        Same shape [A].
    """
    return FULL_CURRENT * (1.0 - LOST_SHARE * np.mod(time / TOP_UP_PERIOD, 1.0))


class BpmCurrent(SensorKind):
    """y = x + c (I − I₀)."""

    id = "bpm-current"
    stage = "sensor"
    parameters = (
        Parameter(
            "slope",
            "m/A",
            -0.1,
            0.1,
            0.0,
            2e-4,
            "Change of the reading per change of the stored current.",
        ),
    )
    title = "current dependence of a BPM"
    sentence = (
        "The reading follows the stored current, although the beam stays. In top-up operation it "
        "shows as a sawtooth. Check the gain control and the attenuators of its electronics."
    )
    equation = "y = x + c (I − I₀), I the stored current, I₀ that at the beginning"
    linear = "slope"
    confused_with = ("bpm-drift", "thermal-drift", "insertion-device")
    splits = "Change the pattern of top-up and see whether the reading follows the current."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let the readings follow the stored current."""
        return CurrentReadings(places, values["slope"], layout.period)

    def unavailable(self, record: Record) -> str:
        """Need a stored current that varies."""
        inherited = super().unavailable(record)
        if inherited:
            return inherited
        current = record.auxiliary.get(CHANNEL)
        if current is None:
            return f"needs the stored current (auxiliary channel {CHANNEL!r})"
        if not np.isfinite(current).all():
            return "the stored current is missing in some rows"
        if np.ptp(current) == 0.0:
            return "the stored current does not change in this record"
        return ""

    def follows(self, values: Values, record: Record) -> tuple[str, ...]:
        """The stored current."""
        return (CHANNEL,)

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Take off what the current makes."""
        return readings - _shift(values, record), np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Add what the current makes."""
        return orbit + _shift(values, record)


def _shift(values: Values, record: Record) -> Matrix:
    current = record.auxiliary[CHANNEL]
    return (values["slope"] * (current - current[0]))[:, None]


class CurrentReadings(Effect):
    """Readings of some BPMs that follow the stored current.

    Args:
        places: Columns of the orbit.
        slope: Change of the reading per current [m/A].
        period: From one orbit to the next [s].

    Attributes:
        stored: Stored current now [A]; whoever simulates one sets it before every tick. While it
            is None the current is that of `top_up_current` at tick · period.
    """

    def __init__(self, places: Indices, slope: float, period: float) -> None:
        self._places, self._slope, self._period = places, slope, period
        self._first: float | None = None
        self.stored: float | None = None

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Shift the readings by the change of the current since the first tick."""
        stored = self.stored
        if stored is None:
            stored = float(top_up_current(np.array(tick * self._period)))
        if self._first is None:
            self._first = stored
        readings = orbit.copy()
        readings[self._places] += self._slope * (stored - self._first)
        return readings

"""BPM that reads the stored current."""

import itertools
from collections.abc import Callable, Sequence

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

_JUMPS = 12
"""Largest steps of all BPMs together that are taken for top-ups, to propose their period. By hand:
two true ones among them suffice."""
_PROPOSED = 3
"""Saw-teeth that are proposed. By hand: the best one is the true one, or a multiple of it."""


def top_up_current(time: Vector, period: float = TOP_UP_PERIOD, first: float = 0.0) -> Vector:
    """Tell the stored current of a ring in top-up operation, a sawtooth.

    Args:
        time: Since the start, any shape [s].
        period: From one top-up to the next [s].
        first: Time of one of them [s].

    Returns:
        Same shape [A].
    """
    return FULL_CURRENT * (1.0 - LOST_SHARE * np.mod((time - first) / period, 1.0))


class BpmCurrent(SensorKind):
    """y = x + c (I − I₀)."""

    id = "bpm-current"
    stage = "sensor"
    parameters = (
        Parameter(
            "slope", "m/A", -0.1, 0.1, 0.0, 2e-4,
            f"Change of the reading per change of the stored current. A record without it is taken "
            f"for one of {FULL_CURRENT:g} A that loses {100 * LOST_SHARE:g} % between top-ups.",
        ),
        Parameter(
            "period", "s", 1e-3, 1e5, TOP_UP_PERIOD, TOP_UP_PERIOD,
            "From one top-up to the next, if the record has no stored current.",
            optional=True,
        ),
        Parameter(
            "first", "s", -1e6, 1e6, 0.0, 0.0,
            "Time of a top-up, if the record has no stored current.",
            optional=True,
        ),
    )  # fmt: skip
    title = "current dependence of a BPM"
    sentence = (
        "The reading follows the stored current, although the beam stays. In top-up operation it "
        "shows as a sawtooth. Check the gain control and the attenuators of its electronics."
    )
    equation = (
        "y = x + c (I − I₀), I the stored current, I₀ that at the beginning; without a record of "
        "it a sawtooth"
    )
    linear = "slope"
    confused_with = ("bpm-drift", "thermal-drift", "insertion-device")
    splits = "Change the pattern of top-up and see whether the reading follows the current."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let the readings follow the stored current."""
        return CurrentReadings(places, values["slope"], layout.period, *_top_up(values))

    def unavailable(self, record: Record) -> str:
        """Need a stored current that varies, if one was recorded."""
        inherited = super().unavailable(record)
        if inherited:
            return inherited
        current = record.auxiliary.get(CHANNEL)
        if current is None:
            return ""
        if not np.isfinite(current).all():
            return "the stored current is missing in some rows"
        if np.ptp(current) == 0.0:
            return "the stored current does not change in this record"
        return ""

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """The slope; when top-ups come, only where no current was recorded."""
        return self.parameters[:1] if CHANNEL in record.auxiliary else self.parameters

    def proposed(
        self, currents: Matrix, pull: Callable[[], Matrix], record: Record
    ) -> Sequence[Values]:
        """Saw-teeth whose top-ups come when the readings of all BPMs jump together."""
        if CHANNEL in record.auxiliary:
            return ()
        moved = record.readings - currents @ record.layout.response.T
        typical = {p.name: p.typical for p in self.parameters}
        found = _top_ups(moved, record)
        return tuple({**typical, "period": period, "first": first} for period, first in found)

    def lacks(self, values: Values, record: Record) -> str:
        """A current that comes back once is a jump, and no saw-tooth."""
        if CHANNEL in record.auxiliary:
            return ""
        period, first = _top_up(values)
        tooth = np.floor((record.time[[0, -1]] - first) / period)
        return "it comes back less than twice" if tooth[1] - tooth[0] < 2 else ""

    def follows(self, values: Values, record: Record) -> tuple[str, ...]:
        """The stored current."""
        return (CHANNEL,) if CHANNEL in record.auxiliary else ()

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Take off what the current makes."""
        return readings - _shift(values, record), np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Add what the current makes."""
        return orbit + _shift(values, record)


def _shift(values: Values, record: Record) -> Matrix:
    current = record.auxiliary.get(CHANNEL)
    if current is None:
        current = top_up_current(record.time, *_top_up(values))
    return (values["slope"] * (current - current[0]))[:, None]


def _top_up(values: Values) -> tuple[float, float]:
    """Period of the top-ups, and the time of one [s]."""
    return values.get("period", TOP_UP_PERIOD), values.get("first", 0.0)


def _top_ups(moved: Matrix, record: Record) -> list[tuple[float, float]]:
    """Periods of top-ups and the time of the first one of each, [s] both, the likeliest first.

    A top-up is a step of all BPMs within one row. Each two of the largest steps tell a period; the
    best one is that whose rows hold most of what steps have beyond the usual, each weighed with
    what chance gives a row.

    Args:
        moved: Readings less what the correctors make, shape (N, n) [m].
        record: Whose they are.
    """
    steps = np.diff(moved, axis=0)
    steps[record.starts[1:]] = 0.0
    usual = np.median(np.abs(steps), axis=0)
    square = np.sum((steps / np.where(usual > 0.0, usual, np.inf)) ** 2, axis=1)
    middle = float(np.median(square))
    spread = float(np.median(np.abs(square - middle)))
    beyond = square - middle - 6.0 * spread  # four standard deviations of chance
    largest = np.sort(np.argsort(-beyond)[:_JUMPS])
    largest = largest[beyond[largest] > 0.0]
    found: dict[tuple[float, float], float] = {}
    for one, other in itertools.combinations(largest.tolist(), 2):
        rows = _every(beyond, one, other - one)
        if len(rows) < 2 or float(np.sum(beyond[rows])) <= 0.0:
            continue
        told = np.flatnonzero(beyond[rows] > 0.0)
        period, first = np.polyfit(told, rows[told], 1) if len(told) > 1 else (other - one, one)
        # A step from row k to row k + 1 is a top-up between their times.
        time = float(record.time[0]) + (first + 0.5) * record.layout.period
        key = (float(period) * record.layout.period, time)
        found[key] = float(np.sum(beyond[rows]))
    best: list[tuple[float, float]] = []
    for period, first in sorted(found, key=lambda one: -found[one]):
        if all(abs(period - other) > record.layout.period for other, _ in best):
            best.append((period, first))
    return best[:_PROPOSED]


def _every(beyond: Vector, start: int, period: int) -> Indices:
    """Rows of a comb through a row, each the best of itself and its neighbours."""
    first = start % period
    teeth = np.arange(first, len(beyond), period)
    near = np.clip(teeth[:, None] + np.array([0, -1, 1]), 0, len(beyond) - 1)
    return near[np.arange(len(teeth)), np.argmax(beyond[near], axis=1)]


class CurrentReadings(Effect):
    """Readings of some BPMs that follow the stored current.

    Args:
        places: Columns of the orbit.
        slope: Change of the reading per current [m/A].
        tick: From one orbit to the next [s].
        period: From one top-up to the next [s].
        first: Time of one of them [s].

    Attributes:
        stored: Stored current now [A]; whoever simulates one sets it before every tick. While it
            is None the current is that of `top_up_current`.
    """

    def __init__(
        self, places: Indices, slope: float, tick: float, period: float, first: float
    ) -> None:
        self._places, self._slope, self._tick = places, slope, tick
        self._top_up = period, first
        self._start: float | None = None
        self.stored: float | None = None

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Shift the readings by the change of the current since the first tick."""
        stored = self.stored
        if stored is None:
            stored = float(top_up_current(np.array(tick * self._tick), *self._top_up))
        if self._start is None:
            self._start = stored
        readings = orbit.copy()
        readings[self._places] += self._slope * (stored - self._start)
        return readings

"""BPM whose readings come late."""

import math
from collections import deque

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_MOST = 10


class BpmLatency(SensorKind):
    """y_n = x(n T − k T) + v_n: between two ticks the orbit goes straight from one to the next.

    Whole ticks are undone in the readings. A part of a tick mixes two orbits, and not the noise of
    their readings: it is taken from the predicted orbit.
    """

    id = "bpm-latency"
    stage = "sensor"
    blurs = True
    parameters = (
        Parameter(
            "ticks",
            "1",
            0.0,
            _MOST,
            0.0,
            1.0,
            "Ticks by which readings are late; need not be whole.",
        ),
    )
    title = "late readings of a BPM"
    sentence = (
        "The BPM shows where the beam was some time ago; look at buffering and at the "
        "time stamps of its electronics."
    )
    equation = "y_n = (1 − f) x_(n−K) + f x_(n−K−1) + v_n with k = K + f ticks"
    confused_with = ("loop-delay", "bpm-lowpass", "missed-read")
    splits = (
        "if all BPMs are late, only time stamps or a motion of the beam that no corrector made "
        "tell it from late correctors"
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold readings back; the first one stands for those before it."""
        return _Late(places, *_ticks(values))

    def grid(self, record: Record) -> tuple[Values, ...]:
        """A hundredth of a tick to six ticks."""
        parts = (0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.55, 0.7, 0.85)
        more = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
        return tuple({"ticks": ticks} for ticks in (*parts, *more))

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Bring readings forward by whole ticks; the last of a stretch stands for later ones."""
        rows = np.arange(len(readings))
        last = np.empty(len(readings), dtype=np.intp)
        for piece in record.stretches:
            last[piece] = piece.stop - 1
        later = np.minimum(rows + _ticks(values)[0], last)
        return readings[later], np.zeros(len(readings))

    def heard(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """The part of a tick by which they are still late."""
        return _ticks(values)[1] * (_before(orbit, 1, record) - orbit)

    def unread(self, values: Values) -> int:
        """The whole ticks."""
        return _ticks(values)[0]

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Hold back; the first row of a stretch stands for those before it."""
        whole, part = _ticks(values)
        late = _before(orbit, whole, record)
        return late + part * (_before(orbit, whole + 1, record) - late)


def _ticks(values: Values) -> tuple[int, float]:
    """Whole ticks, and the part of one."""
    whole = math.floor(values["ticks"])
    return whole, values["ticks"] - whole


def _before(orbit: Matrix, ticks: int, record: Record) -> Matrix:
    rows = np.arange(len(orbit))
    first = np.maximum.accumulate(np.where(record.starts, rows, 0))
    return orbit[np.maximum(rows - ticks, first)]


class _Late(Effect):
    def __init__(self, places: Indices, whole: int, part: float) -> None:
        self._places, self._part = places, part
        self._orbits: deque[Vector] = deque(maxlen=whole + 2)
        self._readings: deque[Vector] = deque(maxlen=whole + 1)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Keep the true orbit."""
        _keep(self._orbits, orbit[self._places])
        return orbit

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Give the reading of whole ticks ago, moved to the part of a tick before that."""
        _keep(self._readings, orbit[self._places])
        readings = orbit.copy()
        between = self._part * (self._orbits[0] - self._orbits[1])
        readings[self._places] = self._readings[0] + between
        return readings


def _keep(past: deque[Vector], now: Vector) -> None:
    """Append; the first of all stands for those before it."""
    while len(past) < (past.maxlen or 0) - 1:
        past.append(now.copy())
    past.append(now.copy())

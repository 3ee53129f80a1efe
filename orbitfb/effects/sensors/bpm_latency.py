"""BPM whose readings come late."""

import math
from collections import deque

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_MOST = 10
_PARTS = (0.001, 0.004, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.55, 0.7, 0.85)
"""Parts of a tick that a scan looks at."""


class BpmLatency(SensorKind):
    """y_n = x(n T − k T) + v_n: between two ticks the orbit goes straight from one to the next."""

    id = "bpm-latency"
    stage = "sensor"
    undoable = False
    parameters = (
        Parameter(
            "ticks",
            "1",
            0.0,
            _MOST,
            0.0,
            1.0,
            "Delay of the readings in ticks. It need not be a whole number.",
        ),
        Parameter(
            name="resampled",
            unit="1",
            low=0.0,
            high=1.0,
            nominal=0.0,
            typical=0.0,
            description="How a delay that is not a whole number of ticks arises.",
            whole=True,
            optional=True,
            meanings={0: "orbit sampled late", 1: "two samples averaged with their noise"},
        ),
    )
    title = "late readings of a BPM"
    sentence = (
        "The BPM shows where the beam was some time ago. Check the buffers and the time stamps of "
        "its electronics."
    )
    equation = (
        "y_n = (1 − f) x_(n−K) + f x_(n−K−1) + v_n with k = K + f ticks; resampled: "
        "y_n = (1 − f) r_(n−K) + f r_(n−K−1) with r_n = x_n + v_n"
    )
    confused_with = ("loop-delay", "bpm-lowpass", "missed-read")
    splits = (
        "If all BPMs are late, only time stamps tell it from late correctors, or a motion of the "
        "beam that no corrector made."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold readings back; the first one stands for those before it."""
        return _Late(places, *_ticks(values), mixed=_mixed(values) > 0.0)

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Fit the ticks; which way they come about is tried, one beside the other."""
        return self.parameters[:1]

    def grid(self, record: Record) -> tuple[Values, ...]:
        """A thousandth of a tick to six ticks."""
        more = (1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
        return tuple({"ticks": ticks, "resampled": 0.0} for ticks in (*_PARTS, *more))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Hold back; the first row of a stretch stands for those before it."""
        whole, part = _ticks(values)
        late = _before(orbit, whole, record)
        return late + part * (_before(orbit, whole + 1, record) - late)


def _ticks(values: Values) -> tuple[int, float]:
    """Whole ticks, and the part of one."""
    whole = math.floor(values["ticks"])
    return whole, values["ticks"] - whole


def _mixed(values: Values) -> float:
    """Share of the earlier of two samples that are averaged; 0 where none are."""
    return _ticks(values)[1] if values.get("resampled", 0.0) else 0.0


def _before(orbit: Matrix, ticks: int, record: Record) -> Matrix:
    rows = np.arange(len(orbit))
    first = np.maximum.accumulate(np.where(record.starts, rows, 0))
    return orbit[np.maximum(rows - ticks, first)]


class _Late(Effect):
    def __init__(self, places: Indices, whole: int, part: float, *, mixed: bool) -> None:
        self._places, self._part, self._mixed = places, part, mixed
        self._orbits: deque[Vector] = deque(maxlen=whole + 2)
        self._readings: deque[Vector] = deque(maxlen=whole + 2)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Keep the true orbit."""
        _keep(self._orbits, orbit[self._places])
        return orbit

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Give the reading of whole ticks ago, moved to the part of a tick before that."""
        _keep(self._readings, orbit[self._places])
        earlier = self._readings if self._mixed else self._orbits
        readings = orbit.copy()
        readings[self._places] = self._readings[1] + self._part * (earlier[0] - earlier[1])
        return readings


def _keep(past: deque[Vector], now: Vector) -> None:
    """Append; the first of all stands for those before it."""
    while len(past) < (past.maxlen or 0) - 1:
        past.append(now.copy())
    past.append(now.copy())

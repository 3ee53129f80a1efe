"""BPM whose readings come ticks late."""

from collections import deque

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.readings import ChangedReadings
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_MOST = 10


class BpmLatency(SensorKind):
    """y_n = x_{n−k} with an integer k."""

    id = "bpm-latency"
    stage = "sensor"
    parameters = (
        Parameter(
            "ticks", "1", 0.0, _MOST, 0.0, 1.0, "Ticks by which readings are late.", whole=True
        ),
    )
    title = "late readings of a BPM"
    sentence = (
        "The BPM shows where the beam was one or more ticks ago; look at buffering and at the "
        "time stamps of its electronics."
    )
    equation = "y_n = x_(n−k) + v_(n−k)"
    confused_with = ("loop-delay", "bpm-lowpass", "missed-read")
    splits = (
        "if all BPMs are late, only time stamps or a motion of the beam that no corrector made "
        "tell it from late correctors"
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold readings back; the first one stands for those before it."""
        return ChangedReadings(places, _Queue(_ticks(values)))

    def grid(self, record: Record) -> tuple[Values, ...]:
        """One to six ticks."""
        return tuple({"ticks": float(ticks)} for ticks in range(1, 7))

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Bring readings forward; the last one of a stretch stands for those that came too late."""
        rows = np.arange(len(readings))
        last = np.empty(len(readings), dtype=np.intp)
        for piece in record.stretches:
            last[piece] = piece.stop - 1
        later = np.minimum(rows + _ticks(values), last)
        return readings[later], np.zeros(len(readings))

    def unread(self, values: Values) -> int:
        """The ticks."""
        return _ticks(values)

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Hold back; the first row of a stretch stands for those before it."""
        rows = np.arange(len(orbit))
        first = np.maximum.accumulate(np.where(record.starts, rows, 0))
        return orbit[np.maximum(rows - _ticks(values), first)]


def _ticks(values: Values) -> int:
    return round(values["ticks"])


class _Queue:
    def __init__(self, ticks: int) -> None:
        self._waiting: deque[Vector] = deque(maxlen=ticks + 1)

    def __call__(self, readings: Vector) -> Vector:
        while len(self._waiting) < (self._waiting.maxlen or 0) - 1:
            self._waiting.append(readings.copy())
        self._waiting.append(readings.copy())
        return self._waiting[0]

"""BPM that follows the beam no more: it repeats its last reading, or reads its noise."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmStuck(SensorKind):
    """y_n = y_{n−1}."""

    id = "bpm-stuck"
    stage = "sensor"
    parameters = ()
    title = "stuck BPM"
    sentence = (
        "The BPM repeats one reading forever, or reads one number and its noise. Its electronics "
        "hang, its data do not arrive, or a cable is off. Mask it: the feedback acts on a reading "
        "that means nothing."
    )
    equation = "y_n = y_(n−1), or y₀ + noise, from the onset on"
    confused_with = ("missed-read",)
    splits = "No experiment is needed. One BPM stands still while the others go on."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Repeat the first reading."""
        return ChangedReadings(places, _Held())

    def unavailable(self, record: Record) -> str:
        """Leave it to the integrity screen: a likelihood of exact repeats is infinite."""
        return "is found by the integrity screen, which looks for BPMs that stand still"

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Give the readings back as they are: a stuck BPM tells nothing of the orbit."""
        return readings, np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Repeat the first row of every stretch."""
        first = np.maximum.accumulate(np.where(record.starts, np.arange(len(orbit)), 0))
        return orbit[first]


class _Held:
    def __init__(self) -> None:
        self._first: Vector | None = None

    def __call__(self, readings: Vector) -> Vector:
        if self._first is None:
            self._first = readings.copy()
        return self._first

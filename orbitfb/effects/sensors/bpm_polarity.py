"""BPM with reversed sign."""

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


class BpmPolarity(SensorKind):
    """y = −x."""

    id = "bpm-polarity"
    stage = "sensor"
    parameters = ()
    title = "reversed sign of a BPM"
    sentence = (
        "The BPM reads displacements with the wrong sign. Two cables are exchanged, or its sign in "
        "the database is wrong. The feedback pushes the orbit the wrong way there."
    )
    equation = "y = −(x + v)"
    confused_with = ("bpm-gain",)
    splits = (
        "No experiment is needed. It equals a gain error of −2, and the simpler effect is named."
    )
    collective = False

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Reverse the readings."""
        return ChangedReadings(places, np.negative)

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Reverse them back."""
        return -readings, np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Reverse."""
        return -orbit

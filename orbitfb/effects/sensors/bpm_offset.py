"""Jump of a BPM's offset."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmOffset(SensorKind):
    """y = x + b, from its beginning on."""

    id = "bpm-offset"
    stage = "sensor"
    parameters = (Parameter("offset", "m", -2e-3, 2e-3, 0.0, 5e-6, "Jump of the reading."),)
    title = "jump of a BPM's offset"
    sentence = (
        "The reading jumped and stayed there, although the beam did not move. The feedback then "
        "made a bump that nobody needs. Check whether a range was switched or the chamber has "
        "moved."
    )
    equation = "y = x + b from the time of the jump on"
    linear = "offset"
    confused_with = ("local-kick", "bpm-drift", "noise-tails")
    splits = (
        "A kick moves the orbit at all BPMs. With few BPMs compare with a photon monitor, or open "
        "the loop before the next jump."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Shift the readings."""
        offset = values["offset"]
        return ChangedReadings(places, lambda readings: readings + offset)

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Shift back."""
        return readings - values["offset"], np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Shift."""
        return orbit + values["offset"]

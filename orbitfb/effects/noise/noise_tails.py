"""Readings with spikes."""

from itertools import product

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class NoiseTails(LatentKind):
    """With the probability p a reading is off by a normal number of standard deviation A."""

    id = "noise-tails"
    stage = "noise"
    target = "bpm"
    strength = "sometimes normal"
    per_bpm = True
    collective = True
    parameters = (
        Parameter(
            "probability",
            "1",
            0.0,
            0.5,
            0.0,
            0.003,
            "Probability of a spike, per reading.",
            log=True,
        ),
        Parameter("amplitude", "m", 0.0, 1e-2, 0.0, 5e-6, "Rms height of the spikes.", log=True),
    )
    title = "spikes in the readings of a BPM"
    sentence = (
        "Now and then one reading of the BPM is far off, for one tick, and no other BPM sees it. "
        "The feedback answers with a kick. Check for loose contacts and for interference from "
        "pulsed magnets."
    )
    equation = "v += s · N(0, A²), s = 1 with probability p, else 0, new at every tick and BPM"
    confused_with = ("noise-level", "bpm-offset", "missed-read")
    splits = "A longer record: a spike is one tick of one BPM, an offset stays."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add spikes."""

        def change(readings: Vector) -> Vector:
            struck = rng.random(len(readings)) < values["probability"]
            return readings + struck * values["amplitude"] * rng.standard_normal(len(readings))

        return ChangedReadings(places, change)

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Rates and sizes, both by factors."""
        sizes = product((3e-4, 3e-3, 3e-2, 0.2), (1e-6, 3e-6, 1e-5, 3e-5, 1e-4))
        return tuple({"probability": p, "amplitude": a} for p, a in sizes)

    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """One metre per unit of z: z itself is the spike."""
        return np.ones_like(orbit)

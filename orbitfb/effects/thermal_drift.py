"""A magnet that creeps."""

import numpy as np

from orbitfb.effects.kicks import Moved, source_names, source_patterns, together
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


class ThermalDrift(SourceKind):
    """x += G_bq θ̇ t."""

    id = "thermal-drift"
    stage = "disturbance"
    parameters = (
        Parameter("rate", "rad/s", -1e-4, 1e-4, 0.0, 5e-9, "Change of the kick per second."),
    )
    title = "kick that grows steadily"
    sentence = (
        "A magnet at this place creeps, and the feedback follows it: look at the temperature of "
        "its girder, its cooling water and its supply."
    )
    equation = "x += G_bq θ̇ t, G the closed orbit per kick"
    linear = "rate"
    confused_with = ("bpm-drift", "energy-drift", "ground-motion-level", "insertion-device")
    splits = "a longer record, together with the temperatures"
    collective = False
    sudden = False
    grows = True

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Kick at all places, more and more."""
        step = values["rate"] * layout.period
        return Moved(together(source_patterns(layout), places), lambda tick: step * tick)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """In proportion to time."""
        return values["rate"] * record.time[:, None]

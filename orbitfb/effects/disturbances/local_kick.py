"""A kick that comes suddenly and stays."""

import numpy as np

from orbitfb.effects.kicks import Moved, source_names, source_patterns, together
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class LocalKick(SourceKind):
    """x += G_bq θ from the onset on."""

    id = "local-kick"
    stage = "disturbance"
    parameters = (
        Parameter("kick", "rad", -1e-3, 1e-3, 0.0, 5e-7, "Angle of the kick, from the onset on."),
    )
    title = "kick at one place"
    sentence = (
        "Something at this place began to kick the beam at one moment and still does. A magnet "
        "moved or tripped, or a corrector outside the feedback changed."
    )
    equation = "x += G_bq θ for t ≥ t₀, G the closed orbit per kick"
    linear = "kick"
    confused_with = ("bpm-offset", "insertion-device", "telegraph", "corrector-stuck")
    splits = (
        "One step shows only its shape, which does not always tell places apart. Wait for the next "
        "step, or move the magnet. An offset of a BPM moves no other BPM."
    )
    collective = False

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Kick at all places."""
        return Moved(together(source_patterns(layout), places), lambda tick: values["kick"])

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Constant; from the first row on nobody sees it."""
        return np.full((len(record), 1), values["kick"])

"""A step of the beam's energy."""

import numpy as np

from orbitfb.effects.kicks import Moved, needs_ring
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.orbit_kinds import RingKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class EnergyOffset(RingKind):
    """x += η δ."""

    id = "energy-offset"
    stage = "optics"
    parameters = (
        Parameter(
            "offset",
            "1",
            -5e-3,
            5e-3,
            0.0,
            1e-5,
            "Relative deviation δ of the energy.",
        ),
    )
    title = "step of the energy"
    sentence = (
        "The energy changed in one step, as after a change of the RF frequency. The horizontal "
        "correctors now hold an orbit that belongs to the RF. Set the RF frequency right."
    )
    equation = "x += η δ, horizontal only; δ = −Δf / (α_c f) by the RF frequency"
    linear = "offset"
    confused_with = ("energy-ramp", "energy-drift", "local-kick")
    splits = "A step of the RF frequency as a reference, or the log of the RF frequency."

    def unavailable(self, record: Record) -> str:
        """It needs the dispersion, and the horizontal plane."""
        return needs_ring(record, ("x",))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add a multiple of the dispersion."""
        return Moved(layout.dispersion(), lambda tick: values["offset"])

    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Add a multiple of the dispersion; from the first row on nobody sees it."""
        return np.tile(values["offset"] * record.layout.dispersion(), (len(record), 1))

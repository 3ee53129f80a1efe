"""An energy that drifts steadily."""

import numpy as np

from orbitfb.effects.kicks import Moved, needs_ring
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.orbit_kinds import RingKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class EnergyRamp(RingKind):
    """x += η δ̇ t."""

    id = "energy-ramp"
    stage = "optics"
    parameters = (
        Parameter(
            "rate",
            "1/s",
            -1e-3,
            1e-3,
            0.0,
            5e-7,
            "Change of the relative energy deviation δ per second.",
        ),
    )
    title = "steady drift of the energy"
    sentence = (
        "The energy drifts, because the length of the ring changes (tide, temperature) while the "
        "RF frequency stays. The horizontal correctors follow it. Let the RF frequency follow "
        "instead."
    )
    equation = "x += η δ̇ t, horizontal only (J. Safranek, Nucl. Instrum. Meth. A 388 (1997) 27)"
    linear = "rate"
    also_called = ("energy-drift",)
    confused_with = ("energy-drift", "energy-offset", "thermal-drift")
    splits = "A step of the RF frequency as a reference, or a longer record."
    sudden = False
    grows = True

    def unavailable(self, record: Record) -> str:
        """It needs the dispersion, and the horizontal plane."""
        return needs_ring(record, ("x",))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add a multiple of the dispersion that grows."""
        step = values["rate"] * layout.period
        return Moved(layout.dispersion(), lambda tick: step * tick)

    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Add a multiple of the dispersion that grows."""
        return np.outer(values["rate"] * record.time, record.layout.dispersion())

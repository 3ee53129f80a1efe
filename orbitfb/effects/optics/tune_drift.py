"""Tunes that drift away from the model's."""

from collections.abc import Sequence

import numpy as np

from orbitfb.effects.kicks import needs_ring
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.optics.tunes import ChangedTunes, steering, tune_change
from orbitfb.effects.orbit_kinds import RingKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_UNIT = 1e-3
"""Shift of a tune at which the change of the response is taken as proportional to it."""


class TuneDrift(RingKind):
    """R(t) = R₀ + t (Δν̇_x ∂R/∂ν_x + Δν̇_y ∂R/∂ν_y)."""

    id = "tune-drift"
    stage = "optics"
    parameters = (
        Parameter(
            "rate_x", "1/s", -1e-2, 1e-2, 0.0, 5e-5, "Change of the horizontal tune per second."
        ),
        Parameter(
            "rate_y", "1/s", -1e-2, 1e-2, 0.0, 5e-5, "Change of the vertical tune per second."
        ),
    )
    title = "drift of the tunes"
    sentence = (
        "The tunes slowly move away from those of the model. The reason is a main power supply or "
        "the temperature of the magnets. Compare with the log of the tune meter."
    )
    equation = "R(t) = R₀ + t (ν̇_x ∂R/∂ν_x + ν̇_y ∂R/∂ν_y), with the derivatives of tune-shift"
    homogeneous = True
    also_called = ("optics-drift",)
    confused_with = ("tune-shift", "optics-drift", "quadrupole-gradient")
    splits = "The log of the tune meter, or the same dither at the beginning and at the end."
    sudden = False
    grows = True

    def unavailable(self, record: Record) -> str:
        """It needs the optics."""
        return needs_ring(record)

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Those of the planes that the record has."""
        return tuple(p for p in self.parameters if p.name[-1] in record.layout.planes)

    def grid(self, record: Record) -> Sequence[Values]:
        """Shifts up to 0.03 by the end of the record, either sign, plane by plane."""
        length = max(float(record.time[-1]), record.layout.period)
        return tuple(
            {f"rate_{p}": end / length if p == plane else 0.0 for p in ("x", "y")}
            for plane in record.layout.planes
            for end in (-0.03, -0.01, -0.003, 0.003, 0.01, 0.03)
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let the response change in proportion to time."""
        return ChangedTunes(_slope(layout, values), layout.period)

    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """What the changed response makes of what steers the beam."""
        layout = record.layout
        return record.time[:, None] * (steering(layout, currents, orbit) @ _slope(layout, values).T)


def _slope(layout: Layout, values: Values) -> Matrix:
    """Change of the response per second."""
    each = {
        plane: tune_change(layout, _UNIT if plane == "x" else 0.0, _UNIT if plane == "y" else 0.0)
        for plane in ("x", "y")
        if values[f"rate_{plane}"]
    }
    total = np.zeros_like(layout.response)
    for plane, change in each.items():
        total += (values[f"rate_{plane}"] / _UNIT) * change
    return total

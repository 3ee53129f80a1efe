"""Tunes that are not the model's."""

import itertools
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

_STEPS = (-0.03, -0.01, -0.003, -0.001, 0.001, 0.003, 0.01, 0.03)


class TuneShift(RingKind):
    """R(ν + Δν) instead of R(ν), the change spread over all quadrupoles."""

    id = "tune-shift"
    stage = "optics"
    parameters = (
        Parameter(
            "dnu_x",
            "1",
            -0.1,
            0.1,
            0.0,
            0.005,
            "Horizontal tune minus that of the model, first order.",
        ),
        Parameter(
            "dnu_y",
            "1",
            -0.1,
            0.1,
            0.0,
            0.005,
            "Vertical tune minus that of the model, first order.",
        ),
    )
    title = "shift of the tunes"
    sentence = (
        "The tunes are not those of the model, and no single magnet is the reason. A main power "
        "supply, the energy or the focusing of insertion devices has changed. Compare with the "
        "tune meter."
    )
    equation = (
        "R(ν + Δν) by the smallest relative errors of all quadrupoles that make 4π Δν_x,y = ±Σ "
        "β_x,y Δk (Courant and Snyder 1958, eq. 4.5)"
    )
    homogeneous = True
    confused_with = ("quadrupole-gradient", "tune-drift", "optics-drift")
    splits = "The measured tunes, or dither of the modes whose numbers are next to the tunes."

    def unavailable(self, record: Record) -> str:
        """It needs the optics."""
        return needs_ring(record)

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Those of the planes that the record has."""
        return tuple(p for p in self.parameters if p.name[-1] in record.layout.planes)

    def grid(self, record: Record) -> Sequence[Values]:
        """Sizes of either sign, plane by plane."""
        planes = record.layout.planes
        return tuple(
            {f"dnu_{p}": step if p == plane else 0.0 for p in ("x", "y")}
            for plane, step in itertools.product(planes, _STEPS)
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Change the response."""
        return ChangedTunes(tune_change(layout, values["dnu_x"], values["dnu_y"]))

    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """What the changed response makes of what steers the beam."""
        layout = record.layout
        change = tune_change(layout, values["dnu_x"], values["dnu_y"])
        return steering(layout, currents, orbit) @ change.T

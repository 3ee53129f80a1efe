"""A quadrupole whose gradient is not the model's."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import two_planes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.optics.gradients import ChangedGradients, gradient_kicks, gradient_scatters
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class QuadrupoleGradient(SourceKind):
    """R_x loses Δk / (1 + Δk G_qq) G_bq G_qc, R_y gains the like."""

    id = "quadrupole-gradient"
    stage = "optics"
    target = "quadrupole"
    parameters = (
        Parameter(
            name="gradient",
            unit="1/m",
            low=-0.04,
            high=0.04,
            nominal=0.0,
            typical=0.005,
            description=(
                "Error Δk1L of the integrated gradient; positive if the quadrupole focuses more in "
                "x."
            ),
        ),
    )
    title = "gradient error of a quadrupole"
    sentence = (
        "The quadrupole focuses more or less than the model says. This changes the response of all "
        "BPMs to all correctors. Check its current, its shunt and its temperature."
    )
    equation = (
        "ΔR_x = −Δk / (1 + Δk G_qq) · G_bq G_qc, opposite sign of Δk in y; exact for one thin "
        "quadrupole (J. Safranek, Nucl. Instrum. Meth. A 388 (1997) 27)"
    )
    linear = "gradient"
    confused_with = ("optics-drift", "tune-shift", "corrector-gain", "bpm-gain", "sextupole")
    splits = (
        "Tones of low-order modes, correctors at other phases, both planes, the measured tunes. "
        "Neighbours at the same phase advance stay alike."
    )
    collective = False
    standing = True

    def healthy_scatter(self, layout: Layout) -> Vector | None:
        """Errors that beat by one or two per cent; none where the ring is not known."""
        return None if layout.ring is None else gradient_scatters(layout)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Solve the closed orbit with the errors of all places together."""
        return ChangedGradients(layout, places, np.full(len(places), values["gradient"]))

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole."""
        return layout.known_ring.names("QUAD")

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, both planes."""
        return two_planes(layout, "QUAD")

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Kicks by the orbit of the correctors, plane by plane."""
        every = np.arange(len(record.layout.known_ring.places("QUAD")))
        return self.drivers_at(every, values, record, currents, orbit)

    def drivers_at(
        self, places: Indices, values: Values, record: Record, currents: Matrix, orbit: Matrix
    ) -> Courses:
        """The same of some quadrupoles."""
        gradients = np.full((1, len(places)), values["gradient"])
        return gradient_kicks(record.layout, places, gradients, currents)

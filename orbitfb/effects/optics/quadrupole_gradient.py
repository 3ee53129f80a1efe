"""A quadrupole whose gradient is not the model's."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import source_names, source_patterns, two_planes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.optics.gradients import (
    ChangedGradients,
    focusing_scatters,
    gradient_kicks,
    gradient_scatters,
    nearest_bpms,
    response_change,
)
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, in_thin_lenses
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class QuadrupoleGradient(SourceKind):
    """R_x loses Δk / (1 + Δk G_qq) G_bq G_qc, R_y gains the like.

    Of a ring that is not known the errors are at its correctors, each in the orbit of the nearest
    BPM: together they make what errors of all quadrupoles make of the response (to 2 % of it on
    the default ring).
    """

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

    def unavailable(self, record: Record) -> str:
        """Need nothing: of a ring that is not known the places are those of the correctors."""
        return "" if record.layout.ring is None else super().unavailable(record)

    def healthy_scatter(self, layout: Layout) -> Vector | None:
        """Errors that beat by one or two per cent."""
        known = layout.ring is not None
        return gradient_scatters(layout) if known else focusing_scatters(layout)

    def together(self, layout: Layout, sizes: Sequence[Vector]) -> Matrix | None:
        """They kick by the orbit that they have made themselves, too."""
        if layout.ring is not None:
            return response_change(layout, sizes)
        near, per_kick = nearest_bpms(layout), source_patterns(layout)
        return in_thin_lenses(per_kick, -sizes[0], per_kick[near], layout.response[near])

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Solve the closed orbit with the errors of all places together."""
        return ChangedGradients(layout, places, np.full(len(places), values["gradient"]))

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole; of a ring that is not known every corrector, by plane."""
        return source_names(layout) if layout.ring is None else layout.ring.names("QUAD")

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, both planes."""
        return source_patterns(layout) if layout.ring is None else two_planes(layout, "QUAD")

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Kicks by the orbit of the correctors, plane by plane."""
        every = np.arange(len(self.places_of(record.layout)))
        return self.drivers_at(every, values, record, currents, orbit)

    def drivers_at(
        self, places: Indices, values: Values, record: Record, currents: Matrix, orbit: Matrix
    ) -> Courses:
        """The same of some quadrupoles."""
        if record.layout.ring is None:
            near = nearest_bpms(record.layout)[places]
            return -values["gradient"] * (currents @ record.layout.response[near].T)
        gradients = np.full((1, len(places)), values["gradient"])
        return gradient_kicks(record.layout, places, gradients, currents)

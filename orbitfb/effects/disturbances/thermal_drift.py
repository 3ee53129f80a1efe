"""A magnet that creeps."""

import math
from collections.abc import Sequence

import numpy as np

from orbitfb.effects.kicks import Moved, source_names, source_patterns, together
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_OF_THE_RECORD = (0.03, 0.1, 0.3, 1.0, np.inf)
"""Time constants that are scanned, in lengths of the record; infinite: the kick grows steadily."""


class ThermalDrift(SourceKind):
    """x += G_bq θ̇ τ (1 − exp(−t/τ))."""

    id = "thermal-drift"
    stage = "disturbance"
    parameters = (
        Parameter(
            "rate",
            "rad/s",
            -1e-4,
            1e-4,
            0.0,
            5e-9,
            "Change of the kick per second, at the onset.",
        ),
        Parameter(
            "tau",
            "s",
            1e-3,
            1e7,
            1e7,
            3600.0,
            (
                "Time constant with which it settles. If it is far longer than the record, the "
                "kick grows steadily."
            ),
            log=True,
            optional=True,
        ),
    )
    title = "kick that grows and settles"
    sentence = (
        "A magnet at this place drifts, and the feedback follows it. Check the temperature of its "
        "girder, its cooling water and its power supply."
    )
    equation = (
        "x += G_bq θ̇ τ (1 − exp(−t/τ)), G the closed orbit per kick: one heat capacity behind one "
        "resistance"
    )
    linear = "rate"
    confused_with = ("bpm-drift", "energy-ramp", "ground-motion-level", "insertion-device")
    splits = "A longer record, together with the temperatures."
    collective = False
    grows = True

    def grid(self, record: Record) -> Sequence[Values]:
        """A kick that settles within the record, or not."""
        length = max(float(np.ptp(record.time)), record.layout.period)
        rate, tau = self.parameters
        return tuple(
            {"rate": rate.typical, "tau": float(np.clip(share * length, tau.low, tau.nominal))}
            for share in _OF_THE_RECORD
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Kick at all places, more and more."""
        tau = _tau(values)

        def course(tick: int) -> float:
            return values["rate"] * tau * -math.expm1(-tick * layout.period / tau)

        return Moved(together(source_patterns(layout), places), course)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Towards the last kick, by a smaller share of what is left at every row."""
        tau = _tau(values)
        return -values["rate"] * tau * np.expm1(-record.time / tau)[:, None]


def _tau(values: Values) -> float:
    """Time constant with which the kick settles [s]."""
    return values.get("tau", ThermalDrift.parameters[1].nominal)

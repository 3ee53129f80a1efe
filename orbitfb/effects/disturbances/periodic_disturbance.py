"""A magnet that swings at one frequency."""

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


class PeriodicDisturbance(SourceKind):
    """x += G_bq (a cos 2πft + b sin 2πft)."""

    id = "periodic-disturbance"
    stage = "disturbance"
    periodic = True
    parameters = (
        Parameter("cosine", "rad", -1e-3, 1e-3, 0.0, 3e-8, "Amplitude of the cosine."),
        Parameter("sine", "rad", -1e-3, 1e-3, 0.0, 3e-8, "Amplitude of the sine."),
        Parameter(
            "frequency",
            "Hz",
            0.0,
            1e4,
            1.0,
            1.0,
            "Frequency, or its alias below half the rate of the loop.",
        ),
    )
    title = "periodic kick at one place"
    sentence = (
        "Something at this place shakes the beam at one frequency: a pump, the mains or one of its "
        "aliases, the booster. Find out what runs at this frequency there."
    )
    equation = "x += G_bq (a cos 2πft + b sin 2πft), G the closed orbit per kick"
    confused_with = ("noise-coloured", "telegraph")
    splits = (
        "Another rate of the loop tells aliases apart. A longer record resolves the frequency "
        "better."
    )
    collective = False

    def grid(self, record: Record) -> Sequence[Values]:
        """One of ten frequencies; `periodic` tells to scan them all by a Fourier transform."""
        half = 0.5 / record.layout.period
        return tuple(
            {"cosine": cosine, "sine": 3e-8 - cosine, "frequency": half * (line + 0.5) / 10}
            for line in range(10)
            for cosine in (0.0, 3e-8)
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Swing at all places."""

        def course(tick: int) -> float:
            phase = 2 * math.pi * values["frequency"] * layout.period * tick
            return values["cosine"] * math.cos(phase) + values["sine"] * math.sin(phase)

        return Moved(together(source_patterns(layout), places), course)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """A wave, counted from the first row."""
        phase = 2 * np.pi * values["frequency"] * record.time
        wave = values["cosine"] * np.cos(phase) + values["sine"] * np.sin(phase)
        return wave[:, None]

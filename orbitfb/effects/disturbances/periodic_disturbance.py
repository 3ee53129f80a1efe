"""A magnet that swings at one frequency."""

from collections.abc import Sequence

import numpy as np

from orbitfb.effects.kicks import Moved, source_names, source_patterns, together
from orbitfb.effects.kinds import Values
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.effects.waves import wave, wave_grid, wave_parameters
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_TYPICAL = 3e-8
"""Amplitude [rad]."""


class PeriodicDisturbance(SourceKind):
    """x += G_bq (a cos 2πft + b sin 2πft)."""

    id = "periodic-disturbance"
    stage = "disturbance"
    periodic = True
    parameters = wave_parameters("rad", most=1e-3, typical=_TYPICAL)
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
        """Some frequencies; all are scanned."""
        return wave_grid(record, _TYPICAL)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Swing at all places."""

        def course(tick: int) -> float:
            return float(wave(values, np.array(layout.period * tick)))

        return Moved(together(source_patterns(layout), places), course)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """A wave, counted from the first row."""
        return wave(values, record.time)[:, None]

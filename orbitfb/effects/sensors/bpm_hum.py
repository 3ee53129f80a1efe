"""A reading that swings at one frequency."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.effects.waves import wave, wave_grid, wave_parameters
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_TYPICAL = 3e-7
"""Amplitude [m]."""


class BpmHum(SensorKind):
    """y = x + a cos 2πft + b sin 2πft."""

    id = "bpm-hum"
    stage = "sensor"
    periodic = True
    parameters = wave_parameters("m", most=1e-3, typical=_TYPICAL)
    title = "hum in a BPM's reading"
    sentence = (
        "The reading swings at one frequency although the beam does not: the mains or one of its "
        "aliases in the electronics or the cables, or a support that vibrates. The feedback moves "
        "the beam along with the reading."
    )
    equation = "y = x + a cos 2πft + b sin 2πft"
    confused_with = ("periodic-disturbance", "noise-coloured", "noise-level")
    splits = (
        "What the beam does shows at all BPMs. Readings without beam, of a pilot tone, show the "
        "electronics alone."
    )

    def grid(self, record: Record) -> Sequence[Values]:
        """Some frequencies; all are scanned."""
        return wave_grid(record, _TYPICAL)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Swing from the first tick on."""
        return ChangedReadings(places, _Swing(values, layout.period))

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Take the wave off."""
        return readings - wave(values, record.time)[:, None], np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Add the wave."""
        return orbit + wave(values, record.time)[:, None]


class _Swing:
    def __init__(self, values: Values, period: float) -> None:
        self._values, self._period, self._ticks = values, period, 0

    def __call__(self, readings: Vector) -> Vector:
        time = self._period * self._ticks
        self._ticks += 1
        return readings + wave(self._values, np.array([time]))

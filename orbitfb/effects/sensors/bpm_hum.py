"""A reading that swings at one frequency."""

import math
from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmHum(SensorKind):
    """y = x + a cos 2πft + b sin 2πft."""

    id = "bpm-hum"
    stage = "sensor"
    periodic = True
    parameters = (
        Parameter("cosine", "m", -1e-3, 1e-3, 0.0, 3e-7, "Amplitude of the cosine."),
        Parameter("sine", "m", -1e-3, 1e-3, 0.0, 3e-7, "Amplitude of the sine."),
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
        """One of ten frequencies; `periodic` tells to scan them all by a Fourier transform."""
        half = 0.5 / record.layout.period
        return tuple(
            {"cosine": cosine, "sine": 3e-7 - cosine, "frequency": half * (line + 0.5) / 10}
            for line in range(10)
            for cosine in (0.0, 3e-7)
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Swing from the first tick on."""
        return ChangedReadings(places, _Swing(values, layout.period))

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Take the wave off."""
        return readings - _wave(values, record), np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Add the wave."""
        return orbit + _wave(values, record)


def _wave(values: Values, record: Record) -> Matrix:
    phase = 2.0 * np.pi * values["frequency"] * record.time
    return (values["cosine"] * np.cos(phase) + values["sine"] * np.sin(phase))[:, None]


class _Swing:
    def __init__(self, values: Values, period: float) -> None:
        self._values, self._turn, self._ticks = values, 2.0 * math.pi * period, 0

    def __call__(self, readings: Vector) -> Vector:
        values = self._values
        phase = self._turn * values["frequency"] * self._ticks
        self._ticks += 1
        return readings + (values["cosine"] * math.cos(phase) + values["sine"] * math.sin(phase))

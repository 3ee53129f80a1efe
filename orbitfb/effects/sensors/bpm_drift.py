"""Drift of a BPM's offset."""

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


class BpmDrift(SensorKind):
    """y = x + r (t − t₀)."""

    id = "bpm-drift"
    stage = "sensor"
    parameters = (
        Parameter("rate", "m/s", -1e-4, 1e-4, 0.0, 0.1e-6, "Change of the offset per second."),
    )
    title = "drift of a BPM's offset"
    sentence = (
        "The reading drifts although the beam does not. The usual reason is the temperature of the "
        "electronics or of the chamber. The feedback moves the beam along with the reading."
    )
    equation = "y = x + r (t − t₀), zero before t₀"
    linear = "rate"
    grows = True
    also_called = ("bpm-walk",)
    confused_with = (
        "bpm-walk",
        "thermal-drift",
        "ground-motion-level",
        "bpm-current",
        "bpm-offset",
    )
    splits = (
        "A drift of the beam shows at all BPMs. Record the temperature of the crate and the stored "
        "current with the orbit."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let the offset grow from the first tick on."""
        return ChangedReadings(places, _Ramp(values["rate"] * layout.period))

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Take the ramp off."""
        return readings - _ramp(values, record), np.zeros(len(readings))

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Add the ramp."""
        return orbit + _ramp(values, record)


def _ramp(values: Values, record: Record) -> Matrix:
    return (values["rate"] * (record.time - record.time[0]))[:, None]


class _Ramp:
    def __init__(self, step: float) -> None:
        self._step, self._ticks = step, 0

    def __call__(self, readings: Vector) -> Vector:
        offset = self._step * self._ticks
        self._ticks += 1
        return readings + offset

"""BPM that averages its readings."""

import math

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class BpmLowpass(SensorKind):
    """y_n = α y_{n−1} + (1 − α) (x_n + v_n), α = exp(−T/τ): the noise is filtered too."""

    id = "bpm-lowpass"
    stage = "sensor"
    parameters = (
        Parameter("tau", "s", 0.0, 100.0, 0.0, 0.1, "Time constant of the averaging.", log=True),
    )
    title = "averaging of a BPM's readings"
    sentence = (
        "The BPM averages over more than one tick. It shows a step of the orbit late and "
        "gradually, with less noise. Compare the filter settings of its electronics."
    )
    equation = (
        "y_n = α y_(n−1) + (1 − α)(x_n + v_n), α = exp(−T/τ), T the period: the filter acts on the "
        "noisy sample"
    )
    confused_with = ("corrector-lag", "bpm-latency", "noise-coloured")
    splits = (
        "This also colours the noise of the BPM; a slow corrector does not. Dither tells it from "
        "coloured noise."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Average, beginning with the first reading."""
        return ChangedReadings(places, _Average(_kept(values, layout.period)))

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Time constants of a fraction of a tick to many ticks."""
        period, high = record.layout.period, self.parameters[0].high
        ticks = (0.145, 0.2, 0.35, 0.6, 1.0, 1.7, 3.0, 6.0, 12.0)
        return tuple({"tau": min(count * period, high)} for count in ticks)

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Undo the filter; the first row of a stretch is taken as settled."""
        kept = _kept(values, record.layout.period)
        restored = readings.copy()
        restored[1:] = (readings[1:] - kept * readings[:-1]) / (1.0 - kept)
        restored[record.starts] = readings[record.starts]
        jacobian = np.full(len(readings), -readings.shape[1] * math.log1p(-kept))
        jacobian[record.starts] = 0.0
        return restored, jacobian

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Filter, from a settled state at the beginning of every stretch."""
        kept = _kept(values, record.layout.period)
        filtered = np.empty_like(orbit)
        for piece in record.stretches:
            rows = orbit[piece]
            filtered[piece], _ = lfilter(
                [1.0 - kept], [1.0, -kept], rows, axis=0, zi=kept * rows[:1]
            )
        return filtered


def _kept(values: Values, period: float) -> float:
    tau = values["tau"]
    return math.exp(-period / tau) if tau > 0.0 else 0.0


class _Average:
    def __init__(self, kept: float) -> None:
        self._kept = kept
        self._last: Vector | None = None

    def __call__(self, readings: Vector) -> Vector:
        if self._last is None:
            self._last = readings.copy()
        else:
            self._last = self._kept * self._last + (1.0 - self._kept) * readings
        return self._last

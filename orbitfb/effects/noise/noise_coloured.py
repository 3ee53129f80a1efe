"""Noise of a BPM that remembers."""

import math

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.effects.readings import ChangedNoise
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class NoiseColoured(NoiseKind):
    """v_n = ρ v_{n−1} + √(1 − ρ²) ε_n: the level stays, neighbouring ticks are correlated."""

    id = "noise-coloured"
    target = "bpm"
    lag = 1
    parameters = (
        Parameter(
            "correlation",
            "1",
            -0.98,
            0.98,
            0.0,
            0.5,
            "Correlation ρ of the noise from tick to tick.",
        ),
    )
    title = "coloured noise of a BPM"
    sentence = (
        "The noise of the BPM has a memory of several ticks. The reason is hum, slow electronics "
        "or a filter. The orbit itself is read without delay."
    )
    equation = "v_n = ρ v_(n−1) + √(1 − ρ²) ε_n, ε white, so the rms of v does not change"
    confused_with = ("bpm-lowpass", "noise-level", "ground-motion-level")
    splits = "Dither: a low-pass also delays the response to correctors, coloured noise does not."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Colour the noise; see `ChangedNoise` for the order of effects."""
        return ChangedNoise(places, _Coloured(values["correlation"]))

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Both signs; the size is found in closed form."""
        return ({"correlation": -0.5}, {"correlation": 0.5})

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every BPM."""
        return tuple(layout.bpms.label(i) for i in range(len(layout.bpms)))

    def patterns(self, layout: Layout) -> Matrix:
        """One BPM each."""
        return np.eye(len(layout.bpms))

    def variance(self, values: Values, reading_noise: float) -> float:
        """ρ r², the covariance of neighbouring ticks."""
        return values["correlation"] * reading_noise**2

    def size(self, variance: float, reading_noise: float) -> float:
        """κ / r², within the bounds."""
        low, high = self.parameters[0].low, self.parameters[0].high
        return min(max(variance / reading_noise**2, low), high)

    def spectrum(
        self, values: Values, reading_noise: float, turn: NDArray[np.complex128]
    ) -> Vector:
        """That of the coloured noise less that of white noise of the same level."""
        kept = values["correlation"]
        coloured = (1.0 - kept**2) / np.abs(1.0 - kept * turn) ** 2
        return reading_noise**2 * np.abs(1.0 - turn) ** 2 * (coloured - 1.0)


class _Coloured:
    def __init__(self, correlation: float) -> None:
        self._kept, self._new = correlation, math.sqrt(1.0 - correlation**2)
        self._last: Vector | None = None

    def __call__(self, noise: Vector) -> Vector:
        if self._last is None:  # already of the level at which it then stays
            self._last = noise.copy()
        else:
            self._last = self._kept * self._last + self._new * noise
        return self._last

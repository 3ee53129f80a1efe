"""An energy that wanders."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import needs_ring
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class EnergyDrift(NoiseKind):
    """x += η δ with δ a random walk."""

    id = "energy-drift"
    stage = "optics"
    target = "ring"
    colour = "walk"
    collective = False
    parameters = (
        Parameter(
            "step", "1", 0.0, 1e-2, 0.0, 3e-7, "Rms change of δ from tick to tick.", log=True
        ),
    )
    title = "energy that wanders"
    sentence = (
        "The energy wanders from tick to tick, so the orbit moves along the dispersion, "
        "horizontally only. Check the RF: its frequency reference and its phase loops."
    )
    equation = "x_n += η δ_n, δ_n = δ_{n−1} + w, so the covariance of the walk gains σ_w² η ηᵀ"
    also_called = ("energy-ramp",)
    confused_with = ("energy-ramp", "ground-motion-level", "noise-correlated")
    splits = "A step of the RF frequency as a reference, or a record of the RF phase."

    def unavailable(self, record: Record) -> str:
        """It needs the dispersion, and the horizontal plane."""
        return needs_ring(record, ("x",))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add a multiple of the dispersion that walks."""
        return _Walk(layout.dispersion(), values["step"], rng)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """One, the energy."""
        return ("energy",)

    def patterns(self, layout: Layout) -> Matrix:
        """Its orbit, the dispersion."""
        return layout.dispersion()[:, None]

    def variance(self, values: Values, reading_noise: float) -> float:
        """κ = σ_w² per tick."""
        return values["step"] ** 2

    def size(self, variance: float, reading_noise: float) -> float:
        """σ_w, negative where there is less than nothing."""
        return math.copysign(math.sqrt(abs(variance)), variance)


class _Walk(Effect):
    def __init__(self, shape: Vector, step: float, rng: np.random.Generator) -> None:
        self._shape, self._step, self._rng = shape, step, rng
        self._height = 0.0

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        self._height += self._step * self._rng.standard_normal()
        return orbit + self._height * self._shape

"""BPM that is noisier, or quieter, than assumed."""

import math

import numpy as np

from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.effects.readings import ChangedNoise
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout


class NoiseLevel(NoiseKind):
    """Σ_ii → k² Σ_ii."""

    id = "noise-level"
    target = "bpm"
    relative = True
    parameters = (
        Parameter(
            "factor",
            "1",
            0.05,
            100.0,
            1.0,
            2.0,
            "Rms noise of the BPM, divided by its usual one.",
        ),
    )
    title = "noise level of a BPM"
    sentence = (
        "The BPM is noisier (or quieter) than assumed. Its readings are right on average. Check "
        "its attenuators, its setting for the bunch pattern and its electronics."
    )
    equation = "v_i → k v_i, so Σ_ii → k² Σ_ii, white in time"
    confused_with = ("ground-motion-level", "noise-coloured", "noise-tails", "noise-correlated")
    splits = "The spectrum: noise of the readings is white, motion of the orbit falls with 1/f²."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Scale the noise; see `ChangedNoise` for the order of effects."""
        factor = values["factor"]
        return ChangedNoise(places, lambda noise: factor * noise)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every BPM."""
        return tuple(layout.bpms.label(i) for i in range(len(layout.bpms)))

    def patterns(self, layout: Layout) -> Matrix:
        """One BPM each."""
        return np.eye(len(layout.bpms))

    def variance(self, values: Values, reading_noise: float) -> float:
        """(k² − 1) r²."""
        return (values["factor"] ** 2 - 1.0) * reading_noise**2

    def size(self, variance: float, reading_noise: float) -> float:
        """√(1 + κ / r²), within the bounds."""
        least = self.parameters[0].low
        return math.sqrt(max(1.0 + variance / reading_noise**2, least**2))

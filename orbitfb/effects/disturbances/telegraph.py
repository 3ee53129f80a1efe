"""A source that switches to and fro."""

import math

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import source_names, source_patterns
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout

_SWITCHES = 0.02


class Telegraph(NoiseKind):
    """x += ±G_bq θ, the sign changing at random."""

    id = "telegraph"
    stage = "disturbance"
    target = "source"
    colour = "walk"
    rare = True
    collective = False
    sudden = False
    parameters = (
        Parameter(
            "kick", "rad", 0.0, 1e-3, 0.0, 1e-7, "Size of the kick, which is +θ or −θ.", log=True
        ),
        Parameter(
            "probability",
            "1",
            1e-4,
            0.5,
            _SWITCHES,
            _SWITCHES,
            "Probability of a change of sign from tick to tick.",
            log=True,
        ),
    )
    title = "source that switches to and fro"
    sentence = (
        "A kick at this place jumps between two values at random times. Look for a supply with a "
        "loose contact, a door, a crane or a vehicle nearby."
    )
    equation = (
        "x += s G_bq θ with s = ±1, which changes sign with probability p per tick: steps of 2 θ, "
        "so the covariance of the walk gains 4 p θ² G Gᵀ, in rare strokes (random telegraph "
        "signal, S. O. Rice, Bell Syst. Tech. J. 23 (1944) 282)"
    )
    confused_with = (
        "ground-motion-level",
        "local-kick",
        "periodic-disturbance",
        "insertion-device",
    )
    splits = "A longer record has more jumps."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Switch all places at their own times."""
        patterns = source_patterns(layout)[:, places]
        return _Switching(patterns, values["kick"], values["probability"], rng)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole and corrector, by plane."""
        return source_names(layout)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick."""
        return source_patterns(layout)

    def variance(self, values: Values, reading_noise: float) -> float:
        """κ = 4 p θ² per tick."""
        return 4.0 * values["probability"] * values["kick"] ** 2

    def size(self, variance: float, reading_noise: float) -> float:
        """θ at the typical probability, negative where there is less than nothing."""
        return math.copysign(math.sqrt(abs(variance) / (4.0 * _SWITCHES)), variance)

    def of_strokes(self, strokes: Vector) -> Values:
        """Every change of sign is a stroke of 2 θ."""
        changes = strokes[strokes != 0.0]
        kick = 0.5 * float(np.sqrt(np.mean(changes**2)))
        return {"kick": kick, "probability": len(changes) / len(strokes)}

    def spectrum(
        self, values: Values, reading_noise: float, turn: NDArray[np.complex128]
    ) -> Vector:
        """Correlations fall by 1 − 2p per tick: flat only where the state lasts for long."""
        kept = 1.0 - 2.0 * values["probability"]
        level = values["kick"] ** 2 * (1.0 - kept**2)
        return level * np.abs(1.0 - turn) ** 2 / np.abs(1.0 - kept * turn) ** 2


class _Switching(Effect):
    def __init__(
        self, patterns: Matrix, kick: float, probability: float, rng: np.random.Generator
    ) -> None:
        self._patterns, self._kick, self._rng = patterns, kick, rng
        self._probability = probability
        self._signs: Vector = rng.choice([-1.0, 1.0], patterns.shape[1])

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        turned = self._rng.random(len(self._signs)) < self._probability
        self._signs = np.where(turned, -self._signs, self._signs)
        return orbit + self._patterns @ (self._kick * self._signs)

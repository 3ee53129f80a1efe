"""Ground that moves more, or less, than assumed."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout


class GroundMotionLevel(NoiseKind):
    """Σ_w → k² Σ_w."""

    id = "ground-motion-level"
    stage = "disturbance"
    target = "ring"
    colour = "walk"
    collective = False
    parameters = (
        Parameter(
            "factor",
            "1",
            0.1,
            100.0,
            1.0,
            2.0,
            "Rms step of the orbit, divided by the usual one.",
        ),
    )
    title = "level of the ground motion"
    sentence = (
        "From tick to tick all quadrupoles move more (or less) than before. The reason is building "
        "work, traffic or wind. The feedback has more to do, and no device is at fault."
    )
    equation = (
        "w_n → k w_n, so Σ_w → k² Σ_w with Σ_w = Σ_q (k1L_q)² G_bq G_bqᵀ σ² (quadrupoles that walk "
        "independently; ATL law: B. Baklakov et al., Tech. Phys. 38 (1993) 894)"
    )
    confused_with = ("noise-level", "corrector-quantisation", "telegraph", "energy-drift")
    splits = (
        "The spectrum: motion falls with 1/f², noise of the readings is white. Compare with a "
        "quiet record."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Enlarge every step of the orbit that the correctors do not make."""
        return _Enlarged(layout.response, values["factor"])

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole, by plane; they move all together. Correctors, in an unknown ring."""
        if layout.ring is None:
            devices = layout.correctors
            return tuple(devices.label(column) for column in range(len(devices)))
        names = layout.known_ring.names("QUAD")
        return tuple(f"{name} ({plane})" for plane in layout.planes for name in names)

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per displacement [m/m]; in a ring that is not known per current [m/A]."""
        if layout.ring is None:
            return layout.response  # what moves stands among the correctors
        strength = np.nan_to_num(layout.known_ring.strength("QUAD"))
        blocks = [layout.orbit_per_kick("QUAD", plane) * strength for plane in layout.planes]
        return np.hstack(blocks)

    def variance(self, values: Values, reading_noise: float) -> float:
        """κ = (k² − 1) of the variance of the usual step of a quadrupole."""
        return (values["factor"] ** 2 - 1.0) * reading_noise**2

    def size(self, variance: float, reading_noise: float) -> float:
        """√(1 + κ / σ²), within the bounds."""
        least = self.parameters[0].low
        return math.sqrt(max(1.0 + variance / reading_noise**2, least**2))


class _Enlarged(Effect):
    """Takes the orbit's departure from its first one, less that of the correctors, k-fold.

    The currents are remembered from `actuate`, so effects on correctors must come before it, and
    all other disturbances too.
    """

    def __init__(self, response: Matrix, factor: float) -> None:
        self._response, self._factor = response, factor
        self._first: Vector | None = None
        self._currents = np.zeros(response.shape[1])

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        self._currents = setpoints
        return setpoints

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        besides = orbit - self._response @ self._currents
        if self._first is None:
            self._first = besides
        return orbit + (self._factor - 1.0) * (besides - self._first)

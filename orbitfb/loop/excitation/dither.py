"""A small known movement of the setpoints from which the learner can tell the response.

The setpoints make an excursion d_n around those of the feedback, so that the change of one
tick has the part a_n = d_n − d_{n−1}: it adds up to nothing, and it is logged by itself, being
an instrument that the reading noise knows nothing of.
"""

from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector


class DitherKind(StrEnum):
    """Distribution of an excursion over ticks and correctors."""

    WHITE = "white"
    """Gaussian, independent."""
    PRBS = "prbs"
    """Pseudo-random binary: plus or minus one amplitude, independent."""


class DitherSettings(Settings):
    """Configuration of the dither."""

    orbit_cost: float = Field(
        default=0.0,
        ge=0,
        le=1e-3,
        description="Orbit motion that it may cause, rms over the BPMs [m]; 0 = off.",
    )
    kind: DitherKind = Field(default=DitherKind.PRBS, description="`white` or `prbs`.")
    seed: int = Field(default=1, ge=0, description="Seed of the random numbers of the dither.")


class Dither:
    """Seeded excursions of the setpoints at a stated cost.

    With all excursions d of one amplitude σ the orbit moves by R d, whose mean square over the
    BPMs is σ² ‖R‖_F² / n. A feedback of gain g in mode space reacts to every excursion one tick
    later, which multiplies the mean square by 2 / (2 − g) (first-order autoregression driven by
    the differences of white noise); the amplitude allows for it.

    Args:
        settings: Cost, kind, seed.
        response: R, shape (n, m) [m/A].
        gain: Of the feedback, 0 to below 2.
        movable: Correctors that it may move, shape (m,); None: all.
    """

    def __init__(
        self,
        settings: DitherSettings,
        response: NDArray[np.float64],
        gain: float = 0.0,
        movable: Mask | None = None,
    ) -> None:
        n, m = response.shape
        per_ampere = float(np.linalg.norm(response)) / np.sqrt(n)
        self._kind = settings.kind
        self._per_metre = float(np.sqrt(1.0 - gain / 2.0)) / per_ampere
        self._cost = settings.orbit_cost
        self._random = np.random.default_rng(settings.seed)
        self._excursion = np.zeros(m)
        self._movable = np.ones(m, dtype=np.bool_) if movable is None else movable

    @classmethod
    def off(cls, correctors: int) -> Self:
        """Build the dither that never moves.

        Args:
            correctors: m.
        """
        return cls(DitherSettings(), np.ones((1, correctors)))

    @property
    def orbit_cost(self) -> float:
        """Orbit motion that it may cause, rms over the BPMs [m]."""
        return self._cost

    @property
    def amplitude(self) -> float:
        """Rms excursion of a corrector [A]."""
        return self._cost * self._per_metre

    def retune(self, orbit_cost: float | None = None, movable: Mask | None = None) -> None:
        """Change what it does from its next excursion on; may be called from any thread.

        Args:
            orbit_cost: Orbit motion that it may cause, rms over the BPMs [m]; None: as it is.
            movable: Correctors that it may move, shape (m,); None: as they are.
        """
        if orbit_cost is not None:
            self._cost = orbit_cost
        if movable is not None:
            self._movable = movable.copy()

    @property
    def excursion(self) -> Vector:
        """Where the setpoints stand around those of the feedback, shape (m,) [A]."""
        return self._excursion

    def propose(self, question: Vector | None = None) -> Vector:
        """Draw the next excursion and return the change towards it, shape (m,) [A].

        Args:
            question: Another excursion to add to it, shape (m,) [A]; None: none.
        """
        change = self._drawn() - self._excursion
        return change if question is None else change + question

    def _drawn(self) -> Vector:
        amplitude = self.amplitude
        if amplitude == 0:  # also takes back the last excursion of one that was switched off
            return np.zeros(len(self._excursion), dtype=np.float64)
        m = len(self._excursion)
        if self._kind is DitherKind.WHITE:
            aim = amplitude * self._random.standard_normal(m)
        else:
            aim = amplitude * (2.0 * self._random.integers(0, 2, m) - 1.0)
        return np.asarray(self._movable * aim, dtype=np.float64)

    def settle(self, change: Vector) -> None:
        """Note the part of a proposed change that was written, shape (m,) [A].

        A corrector that it may not move any more stays where it is, and that counts as no
        excursion: it is not brought back when it may move again.
        """
        self._excursion = self._movable * (self._excursion + change)

    def restart(self, held: bool = False) -> None:
        """Take the setpoints as they are for those of the feedback.

        Args:
            held: Whether the loop was only HELD in between.
        """
        self._excursion = np.zeros_like(self._excursion)

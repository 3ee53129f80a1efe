"""Modes in which drift and reading noise are both uncorrelated, for BPMs of unequal noise."""

from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.layout import Layout
from orbitfb.physics.optics import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModes:
    """What turns readings into modes of one reading noise each.

    Readings are taken over the noise of their BPM, relative to the usual one; in their space axes
    are orthonormal: z = (y / spread) · axes.

    Args:
        axes: Orthonormal columns, in falling order of what the ground makes of them, (n, n).
        spread: Reading noise of every BPM over the usual one, geometric mean 1, shape (n,).
        scatter: How far healthy BPMs differ from each other: standard deviation of the logarithm
            of their variance.
        deaf: BPMs that tell nothing of the orbit, whatever their noise.

    Attributes:
        directions: z = y · directions, shape (n, n).
    """

    axes: Matrix
    spread: Vector
    scatter: float = 0.0
    deaf: tuple[int, ...] = ()
    directions: Matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "directions", self.axes / self.spread[:, None])

    @property
    def levels(self) -> Vector:
        """Logarithm of every BPM's noise variance over the usual one, 0 of the deaf; shape (n,)."""
        levels = 2.0 * np.log(self.spread)
        levels[list(self.deaf)] = 0.0
        return levels

    @classmethod
    def even(cls, axes: Matrix) -> "NoiseModes":
        """All BPMs alike.

        Args:
            axes: Orthonormal columns, shape (n, n).
        """
        return cls(axes, np.ones(len(axes)))

    @classmethod
    def of(
        cls,
        layout: Layout,
        spread: Vector | None = None,
        scatter: float = 0.0,
        deaf: tuple[int, ...] = (),
    ) -> "NoiseModes":
        """Those of the orbits that quadrupoles make, each moving alone.

        Without a ring those of the response.

        Args:
            layout: Devices.
            spread: As above; None: all BPMs are alike.
            scatter: As above.
            deaf: As above; each is a mode of its own, the last ones.
        """
        if layout.ring is None or not len(layout.ring.places("QUAD")):
            covariance = layout.response @ layout.response.T
        else:
            strength = layout.ring.strength("QUAD")
            moved = [layout.orbit_per_kick("QUAD", plane) * strength for plane in layout.planes]
            covariance = np.sum([orbit @ orbit.T for orbit in moved], axis=0)
        spread = np.ones(len(covariance)) if spread is None else spread
        covariance /= np.outer(spread, spread)
        for column in deaf:
            covariance[column] = covariance[:, column] = 0.0
            covariance[column, column] = -1.0
        axes = np.linalg.eigh(covariance)[1][:, ::-1]
        return cls(axes, spread, scatter, deaf)

"""Modes in which drift and reading noise are both uncorrelated, for BPMs of unequal noise."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Layout

Ground = Literal["alone", "girders", "cells", "diffusion", "from the first place", "round"]
"""How quadrupoles move: each alone, with those within some metres, or as the ground diffuses along
the ring: as it is surveyed from the first place on, closed or not, or alike everywhere."""
GROUNDS: tuple[Ground, ...] = get_args(Ground)
_TOGETHER = {"girders": 3.0, "cells": 20.0}
"""Distance over which motion fades to 1/e [m]."""


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
        ground: How quadrupoles move in these modes.

    Attributes:
        directions: z = y · directions, shape (n, n).
    """

    axes: Matrix
    spread: Vector
    scatter: float = 0.0
    deaf: tuple[int, ...] = ()
    ground: Ground = "alone"
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
        ground: Ground = "alone",
    ) -> "NoiseModes":
        """Those of the orbits that quadrupoles make.

        Without a ring those of the response.

        Args:
            layout: Devices.
            spread: As above; None: all BPMs are alike.
            scatter: As above.
            deaf: As above; each is a mode of its own, the last ones.
            ground: As above.
        """
        covariance = _covariance(layout, ground).copy()
        spread = np.ones(len(covariance)) if spread is None else spread
        covariance /= np.outer(spread, spread)
        for column in deaf:
            covariance[column] = covariance[:, column] = 0.0
            covariance[column, column] = -1.0
        axes = np.linalg.eigh(covariance)[1][:, ::-1]
        return cls(axes, spread, scatter, deaf, ground)


@lru_cache(maxsize=16)
def _covariance(layout: Layout, ground: Ground) -> Matrix:
    """Orbits at the BPMs, to a factor, shape (n, n)."""
    if layout.ring is None or not len(layout.ring.places("QUAD")):
        return layout.response @ layout.response.T
    strength, together = layout.ring.strength("QUAD"), _moves(layout.ring, ground)
    moved = [layout.orbit_per_kick("QUAD", plane) * strength for plane in layout.planes]
    return np.sum([orbit @ together @ orbit.T for orbit in moved], axis=0)


def _moves(ring: Ring, ground: Ground) -> Matrix:
    """Covariance of the motion of the quadrupoles, to a factor, shape (q, q)."""
    place, around = ring.table.s[ring.places("QUAD")], ring.parameters.circumference
    if ground == "alone":
        return np.eye(len(place))
    far = np.abs(place[:, None] - place)
    far = np.minimum(far, around - far)
    if ground in _TOGETHER:
        return np.exp(-far / _TOGETHER[ground])
    if ground == "round":
        return around / 12.0 - 0.5 * far * (1.0 - far / around)
    along = np.minimum.outer(place, place)
    return along - np.outer(place, place) / around if ground == "diffusion" else along

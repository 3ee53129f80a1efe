"""Second moments of transformed steps by band, and what a noise makes of them."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform

LEAST_VARIANCE = 1e-6
"""Least variance of a BPM's noise, of the median BPM's: one that repeats its reading has none."""


@dataclass(frozen=True, slots=True, eq=False)
class Moments:
    """Second moments Σ_f z_f z_fᵀ of transformed steps, by band, shape (B, n, n) [m²].

    Args:
        total: By band.
        count: Frequencies of every band, shape (B,).
        eigenvalue: Mean λ of every band, shape (B,).
    """

    total: Matrix
    count: Vector
    eigenvalue: Vector

    @classmethod
    def of(cls, spectrum: Matrix, transform: StepTransform) -> "Moments":
        """Sum them up."""
        parts = [spectrum[transform.members(band)] for band in range(len(transform.count))]
        count = transform.count.astype(float)
        mean = np.bincount(transform.band, transform.eigenvalue) / count
        return cls(np.stack([part.T @ part for part in parts]), count, mean)

    def beside(self, more: Matrix) -> "Moments":
        """The same with others added, shape (B, n, n) [m²]."""
        return replace(self, total=self.total + more)

    @classmethod
    def halves(
        cls, spectrum: Matrix, transform: StepTransform, more: Matrix
    ) -> "tuple[Moments, Moments]":
        """Those of every other frequency, and of the rest.

        Args:
            spectrum: Transformed steps, shape (T, n) [m].
            transform: Of the record.
            more: Others that are added to all, shared by count, shape (B, n, n) [m²].
        """
        even = np.arange(len(transform)) % 2 == 0
        found: list[Moments] = []
        for chosen in (even, ~even):
            parts = [
                rows[chosen[rows]]
                for rows in (transform.members(band) for band in range(len(transform.count)))
            ]
            count = np.array([float(len(rows)) for rows in parts])
            total = np.stack([spectrum[rows].T @ spectrum[rows] for rows in parts])
            total += more * (count / transform.count)[:, None, None]
            level = [float(np.sum(transform.eigenvalue[rows])) for rows in parts]
            found.append(cls(total, count, np.array(level) / np.maximum(count, 1.0)))
        return found[0], found[1]

    def log_density(self, noise: StepNoise) -> float:
        """Log density of the steps under a noise, but for a constant."""
        square = np.einsum("nm,bnk,km->bm", noise.modes, self.total, noise.modes, optimize=True)
        variance = noise.ratio + self.eigenvalue[:, None]
        by_band = self.count[:, None] * np.log(variance) + square / variance
        whitened = float(np.linalg.slogdet(noise.modes)[1])
        return float(np.sum(self.count)) * whitened - 0.5 * float(np.sum(by_band))


def weighed_sums(
    walk: Matrix, white: Vector, moments: Moments
) -> tuple[Matrix, Matrix, Vector, Vector]:
    """Σ Ω S Ω and Σ n Ω over bands, and the diagonals of both weighted by λ, Ω = (Q + λV)⁻¹.

    In the modes that part walk and noise Ω is diagonal, so that the bands are summed there.
    """
    noise = StepNoise(walk, np.diag(white))
    modes = noise.modes
    single = modes.astype(np.float32)
    turned = single.T @ moments.total.astype(np.float32) @ single
    pull, shaken = np.zeros_like(walk), np.zeros_like(walk)
    expected, usual = np.zeros(len(walk)), np.zeros(len(walk))
    for square, count, eigenvalue in zip(turned, moments.count, moments.eigenvalue, strict=True):
        inverse = 1.0 / (noise.ratio + eigenvalue)
        seen = inverse[:, None] * square * inverse
        pull += seen
        shaken += eigenvalue * seen
        expected += count * inverse
        usual += count * eigenvalue * inverse
    return (
        modes @ pull @ modes.T,
        (modes * expected) @ modes.T,
        np.einsum("nm,mk,nk->n", modes, shaken, modes, optimize=True),
        (modes**2) @ usual,
    )

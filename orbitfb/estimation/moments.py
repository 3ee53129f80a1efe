"""Second moments of transformed steps by band, and what a noise makes of them."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import FINEST, Vector
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
        cls, spectrum: Matrix, transform: StepTransform, more: Matrix | None = None
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
            if more is not None:
                total += more * (count / transform.count)[:, None, None]
            level = np.array([float(np.sum(transform.eigenvalue[rows])) for rows in parts])
            usual = transform.band_levels()  # of a band of which it has no frequency
            mean = np.where(count > 0.0, level / np.maximum(count, 1.0), usual)
            found.append(cls(total, count, mean))
        return found[0], found[1]

    def squares(self, noise: StepNoise) -> Matrix:
        """Sums of squares of the modes of a noise by band, shape (B, n)."""
        return np.einsum("nm,bnk,km->bm", noise.modes, self.total, noise.modes, optimize=True)

    def log_density(self, noise: StepNoise) -> float:
        """Log density of the steps under a noise, but for a constant."""
        square = self.squares(noise)
        variance = noise.variance_at(self.eigenvalue)
        by_band = self.count[:, None] * np.log(variance) + square / variance
        whitened = float(np.linalg.slogdet(noise.modes)[1])
        return float(np.sum(self.count)) * whitened - 0.5 * float(np.sum(by_band))

    def more(self, noise: StepNoise, other: StepNoise) -> float:
        """Log density under a noise beyond that under another."""
        return self.log_density(noise) - self.log_density(other)


def at_least(reading: Vector) -> Vector:
    """Let no BPM have less noise than one can have, variances of shape (n,) [m²].

    Where something large is not modelled the walk would take all, and leave the noise nothing.
    """
    return np.maximum(reading, max(LEAST_VARIANCE * float(np.median(reading)), FINEST**2))


def weighed_sums(noise: StepNoise, moments: Moments) -> tuple[Matrix, Matrix, Matrix, Matrix]:
    """Σ r Ω S Ω and Σ n r Ω over bands, and both with λ for r, Ω = (r Q + λN)⁻¹; each (n, n).

    In the modes that part walk and noise Ω is diagonal, so that the bands are summed there.
    """
    modes = noise.modes
    single = modes.astype(np.float32)
    turned = single.T @ moments.total.astype(np.float32) @ single
    pull, shaken = np.zeros_like(noise.walk), np.zeros_like(noise.walk)
    expected, usual = np.zeros(len(modes)), np.zeros(len(modes))
    factors = noise.reddened(moments.eigenvalue)
    for square, count, eigenvalue, factor in zip(
        turned, moments.count, moments.eigenvalue, factors, strict=True
    ):
        inverse = 1.0 / (noise.ratio * factor + eigenvalue)
        seen = inverse[:, None] * square * inverse
        root = np.sqrt(factor)
        pull += root[:, None] * seen * root
        shaken += eigenvalue * seen
        expected += count * factor * inverse
        usual += count * eigenvalue * inverse
    return (
        modes @ pull @ modes.T,
        (modes * expected) @ modes.T,
        modes @ shaken @ modes.T,
        (modes * usual) @ modes.T,
    )

"""Estimate the floor of a record: how its orbit walks, and how its readings are noisy.

The walk's covariance Q may have any shape; an inverse-Wishart prior keeps it near what magnets that
move make of it. The reading noise is one variance per BPM, and where it is asked for a part that is
coherent from BPM to BPM and new at every tick (vibration faster than the record). Both follow by
expectation maximisation (A. Dempster, N. Laird, D. Rubin, J. R. Stat. Soc. B 39 (1977) 1) from the
second moments of the transformed steps in bands of λ.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import LARGEST, LEAST_STEPS
from orbitfb.estimation.transform import Matrix, StepTransform

_RESTART = 1e-3
"""Share of an even part that a weight begins with at least: one that is zero could not grow."""

_STRIDE = 1.5
"""Power of the ratio by which a weight rises or falls [1]: with 1 a weight that alone makes its
orbit is right at once and those that share one are slow; below 2 both settle."""

_GLANCE = 2
"""Steps up the likelihood by which priors are compared: their order is that after sixteen."""

_LEAST_VARIANCE = 1e-6
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


def first_noise(steps: Matrix, shape: Matrix) -> StepNoise:
    """Tell noise and walk from neighbouring steps: E Δz_n Δz_{n+1} = −v².

    Args:
        steps: From row to row, shape (T, n) [m].
        shape: Prior shape of the walk's covariance, shape (n, n).

    Raises:
        EstimationError: Too few steps, or steps that are all zero.
    """
    if len(steps) < LEAST_STEPS:
        raise EstimationError(
            f"{len(steps)} steps from row to row are too few to tell noise from motion; "
            f"give at least {LEAST_STEPS}, better a thousand"
        )
    square = np.mean(steps**2, axis=0)
    typical = float(np.median(square))
    if not typical > 0.0:
        raise EstimationError(
            "most BPMs read the same at every row: no noise, no motion; "
            "give a record of a live orbit"
        )
    noise = -np.mean(steps[1:] * steps[:-1], axis=0)
    noise = np.clip(noise, 0.02 * square, 0.5 * np.maximum(square, 1e-3 * typical))
    walk = max(float(np.mean(square - 2.0 * noise)), 1e-4 * float(np.mean(noise)))
    return StepNoise(shape * (walk * len(shape) / float(np.trace(shape))), np.diag(noise))


def improve(
    noise: StepNoise,
    moments: Moments,
    shape: Matrix,
    iterations: int,
    counts: float,
) -> StepNoise:
    """Go some steps up the likelihood, by minorisation.

    H. Zhou et al., J. Comput. Graph. Stat. 28 (2019) 350, for matrices: unlike expectation
    maximisation it is quick also where the walk is small beside the noise.

    Args:
        noise: To begin with.
        moments: Of what no model explains.
        shape: Prior mean of the walk's covariance, shape (n, n) [m²].
        iterations: How many.
        counts: What the prior is worth, in steps.
    """
    walk, white = noise.walk, np.diag(noise.white).copy()
    for _ in range(iterations):
        pull, expected, noisy, usual = _sums(walk, white, moments)
        walk = _nearer(walk, pull, expected, shape, counts)
        white = white * np.sqrt(noisy / usual)
        white = np.maximum(white, _LEAST_VARIANCE * float(np.median(white)))
    return StepNoise(walk, np.diag(white))


def trusted(noise: StepNoise, halves: tuple[Moments, Moments], choices: Sequence[float]) -> float:
    """What the prior shape of the walk is worth, in steps: by what one half says of the other.

    Where the shapes are those of the ring's ground, a walk that leaves them follows chance and fits
    the other half of the frequencies worse; where they are not, better.

    Args:
        noise: That the shapes make; its walk is the prior's.
        halves: Moments of every other frequency, and of the rest.
        choices: Counts to choose from.
    """
    worth = [
        sum(
            other.log_density(improve(noise, one, noise.walk, _GLANCE, counts))
            for one, other in (halves, halves[::-1])
        )
        for counts in choices
    ]
    return choices[int(np.argmax(worth))]


def _nearer(walk: Matrix, pull: Matrix, expected: Matrix, shape: Matrix, counts: float) -> Matrix:
    """Solve Q E Q + c Q = Q₀ P Q₀ + c S: the maximum of what bounds the log likelihood from below.

    Args:
        walk: Q₀.
        pull: P, what the data pull.
        expected: E, what the covariance expects.
        shape: S, prior mean.
        counts: c, what the prior is worth.
    """
    root = np.linalg.cholesky(expected)
    wanted = root.T @ (walk @ pull @ walk + counts * shape) @ root
    size, modes = np.linalg.eigh((wanted + wanted.T) / 2.0)
    solved = np.sqrt(np.maximum(size, 0.0) + counts**2 / 4.0) - counts / 2.0
    along = np.linalg.solve(root.T, modes)
    return (along * solved) @ along.T


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """What the covariance of a walk may be made of: a sum with weights that are not negative.

    Args:
        broad: Covariances of any scale, each (n, n).
        single: Patterns whose amplitudes walk each for itself, shape (n, P).
    """

    broad: tuple[Matrix, ...]
    single: Matrix

    def __len__(self) -> int:
        return len(self.broad) + self.single.shape[1]

    def total(self, weights: Vector) -> Matrix:
        """Sum them up by their weights, shape (n, n)."""
        scale = np.sqrt(weights[len(self.broad) :])
        used = scale > 0.0
        scaled = self.single[:, used] * scale[used]
        found = scaled @ scaled.T  # in double precision: its inverse is asked for
        for weight, one in zip(weights, self.broad, strict=False):
            found += weight * one
        return found

    def seen(self, weighing: Matrix) -> Vector:
        """Trace of every shape with a weighing matrix, shape (F,)."""
        broad = np.array([float(np.sum(weighing * one)) for one in self.broad])
        narrow = self.single.astype(np.float32)
        along = weighing.astype(np.float32) @ narrow
        single = np.einsum("np,np->p", narrow, along, dtype=float)
        return np.concatenate([broad, single])


def fit_shapes(
    noise: StepNoise,
    moments: Moments,
    shapes: Shapes,
    held: Matrix,
    weights: Vector | None = None,
    rounds: int = 30,
) -> tuple[StepNoise, Vector]:
    """Fit a walk that is a mixture of shapes, and one reading noise per BPM.

    The weights w of Q = Σ w_k F_k and the variances of the noise rise and fall by the ratio of what
    the data pull to what the covariance expects (T. W. Anderson, Ann. Stat. 1 (1973) 135); unlike
    expectation maximisation this is quick also where a component is small beside the noise.

    Args:
        noise: To begin with.
        moments: Of what no model explains.
        shapes: Of the walk.
        held: Covariance of the walk that is known besides, shape (n, n) [m²].
        weights: To begin with, of an earlier fit; None or empty: of the data's own level.
        rounds: At most; it ends when no weight of note moves by more than a hundredth.

    Returns:
        The noise, and the weights w, shape (F,).
    """
    white = np.diag(noise.white).copy()
    unit = shapes.seen(np.eye(len(white)))
    if weights is None or not len(weights):
        weights = _start(white, moments, shapes, unit)
    share = weights * unit
    weights = np.maximum(weights, _RESTART * share.sum() / len(shapes) / np.maximum(unit, 1e-300))
    for _ in range(rounds):
        pull, expected, shaken, usual = _sums(shapes.total(weights) + held, white, moments)
        usually = shapes.seen(expected)
        ratio = np.where(usually > 0.0, shapes.seen(pull) / np.maximum(usually, 1e-300), 0.0)
        most = LARGEST * float(np.sum(weights * unit)) / max(len(shapes), 1)
        weights = weights * np.maximum(ratio, 1e-3) ** _STRIDE
        single = slice(len(shapes.broad), None)
        weights[single] = np.minimum(weights[single], most / np.maximum(unit[single], 1e-300))
        white = np.maximum(white * shaken / usual, _LEAST_VARIANCE * float(np.median(white)))
        share = weights * unit / float(np.sum(weights * unit))
        if np.all(np.abs(ratio - 1.0)[share > 0.01] < 0.01):
            break
    return StepNoise(shapes.total(weights) + held, np.diag(white)), weights


def _sums(walk: Matrix, white: Vector, moments: Moments) -> tuple[Matrix, Matrix, Vector, Vector]:
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


def _start(white: Vector, moments: Moments, shapes: Shapes, unit: Vector) -> Vector:
    """Weights of shapes, each a share of the level at which all together are most likely.

    All single patterns together begin with the share of one broad shape.
    """
    several = max(shapes.single.shape[1], 1)
    share = np.concatenate(
        [np.ones(len(shapes.broad)), np.full(len(unit) - len(shapes.broad), 1.0 / several)]
    )
    share = share / share.sum() * len(white) / np.maximum(unit, 1e-300)
    mixed = StepNoise(shapes.total(share * float(np.mean(white))), np.diag(white))
    square = np.einsum("nm,bnk,km->bm", mixed.modes, moments.total, mixed.modes, optimize=True)
    levels = np.geomspace(1e-6, 1e3, 60)
    count, eigenvalue = moments.count[:, None], moments.eigenvalue[:, None]
    worth = [
        float(np.sum(-0.5 * count * np.log(v) - 0.5 * square / v))
        for v in (level * mixed.ratio + eigenvalue for level in levels)
    ]
    return share * float(np.mean(white)) * levels[int(np.argmax(worth))]

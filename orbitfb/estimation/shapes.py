"""Shapes that the walk of an orbit may have, and how much of each is in it."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.moments import Moments, at_least, weighed_sums
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import LARGEST
from orbitfb.estimation.transform import Matrix

_RESTART = 1e-3
"""Share of an even part that a weight begins with at least: one that is zero could not grow."""

_STRIDE = 1.5
"""Power of the ratio by which a weight rises or falls [1]: with 1 a weight that alone makes its
orbit is right at once and those that share one are slow; below 2 both settle."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """What the covariance of a walk may be made of: a sum with weights that are not negative.

    Args:
        broad: Covariances of any scale, each (n, n).
        single: Patterns whose amplitudes walk each for itself, shape (n, P).
        bodies: How many things move each for itself: what a single pattern has of the walk has an
            exponential prior, whose mean is an even share among so many; zero: no prior.
    """

    broad: tuple[Matrix, ...]
    single: Matrix
    bodies: int = 0

    def __len__(self) -> int:
        return len(self.broad) + self.single.shape[1]

    @property
    def even(self) -> "Shapes":
        """The broad ones alone: no body moves more than others of its kind."""
        return Shapes(self.broad, self.single[:, :0])

    def total(self, weights: Vector) -> Matrix:
        """Sum them up by their weights, shape (n, n)."""
        scale = np.sqrt(weights[len(self.broad) :])
        used = scale > 0.0
        scaled = self.single[:, used] * scale[used]
        found = scaled @ scaled.T  # in double precision: its inverse is asked for
        for weight, one in zip(weights, self.broad, strict=False):
            found += weight * one
        return found

    def scaled(self, weights: Vector, levels: Vector) -> Vector:
        """Weights of shapes whose orbits grow, shape (F,).

        Args:
            weights: Before, shape (F,); empty: none are known.
            levels: By how much the variance of each reading grows, shape (n,) [1].
        """
        if not len(weights):
            return weights
        usual = self.seen(np.eye(len(levels)))
        return weights * self.seen(np.diag(levels)) / np.maximum(usual, 1e-300)

    def rarity(self, unit: Vector, weights: Vector) -> Vector:
        """Twice what one more of each weight takes off the log prior, shape (F,).

        Args:
            unit: Trace of every shape, shape (F,).
            weights: Of the shapes now, shape (F,).
        """
        found = np.zeros(len(self))
        single = slice(len(self.broad), None)
        found[single] = 2.0 * self.bodies * unit[single] / float(weights @ unit)
        return found

    def cost(self, weights: Vector) -> float:
        """What weights, shape (F,), take off the log prior beyond walking with the ring [nats]."""
        if not self.bodies or not len(weights):
            return 0.0
        share = weights * self.seen(np.eye(len(self.single)))
        return self.bodies * float(np.sum(share[len(self.broad) :]) / np.sum(share))

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
    the data pull to what the covariance and the prior expect (T. W. Anderson, Ann. Stat. 1 (1973)
    135); unlike expectation maximisation this is quick also where a component is small beside the
    noise.

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
    reading = noise.reading
    unit = shapes.seen(np.eye(len(reading)))
    if weights is None or not len(weights):
        weights = _start(noise, moments, shapes, unit)
    share = weights * unit
    weights = np.maximum(weights, _RESTART * share.sum() / len(shapes) / np.maximum(unit, 1e-300))
    for _ in range(rounds):
        noise = noise.improved(shapes.total(weights) + held, reading)
        pull, expected, noisy, usual = weighed_sums(noise, moments)
        usually = shapes.seen(expected) + shapes.rarity(unit, weights)
        ratio = np.where(usually > 0.0, shapes.seen(pull) / np.maximum(usually, 1e-300), 0.0)
        most = LARGEST * float(np.sum(weights * unit)) / max(len(shapes), 1)
        weights = weights * np.maximum(ratio, 1e-3) ** _STRIDE
        single = slice(len(shapes.broad), None)
        weights[single] = np.minimum(weights[single], most / np.maximum(unit[single], 1e-300))
        reading = reading * np.diag(noisy) / np.diag(usual)
        reading = at_least(reading)
        share = weights * unit / float(np.sum(weights * unit))
        if np.all(np.abs(ratio - 1.0)[share > 0.01] < 0.01):
            break
    return noise.improved(shapes.total(weights) + held, reading), weights


def fit_shaken(
    noise: StepNoise,
    moments: Moments,
    shapes: Shapes,
    weights: Vector | None = None,
    rounds: int = 10,
) -> tuple[StepNoise, Vector]:
    """Fit motion that is new at every row, a mixture of shapes, beside a walk that stays.

    As `fit_shapes`: vibration and ripple faster than the record come down on every frequency alike.

    Args:
        noise: To begin with; what it says of such motion is forgotten.
        moments: Of what no model explains.
        shapes: Of the motion.
        weights: To begin with; None: the motion is as large as the noise of the readings.
        rounds: How many.

    Returns:
        The noise, and the weights, shape (F,).
    """
    reading = noise.reading
    unit = np.maximum(shapes.seen(np.eye(len(reading))), 1e-300)
    if weights is None:
        weights = float(np.sum(reading)) / len(shapes) / unit
    found = noise
    for _ in range(rounds):
        shaken = shapes.total(weights)
        found = replace(noise, white=np.diag(reading) + shaken, shaken=shaken)
        _, _, noisy, usual = weighed_sums(found, moments)
        ratio = shapes.seen(noisy) / np.maximum(shapes.seen(usual), 1e-300)
        weights = weights * ratio**_STRIDE
        reading = reading * np.diag(noisy) / np.diag(usual)
        reading = at_least(reading)
    return found, weights


def _start(noise: StepNoise, moments: Moments, shapes: Shapes, unit: Vector) -> Vector:
    """Weights of shapes, each a share of the level at which all together are most likely.

    All single patterns together begin with the share of one broad shape.
    """
    several = max(shapes.single.shape[1], 1)
    share = np.concatenate(
        [np.ones(len(shapes.broad)), np.full(len(unit) - len(shapes.broad), 1.0 / several)]
    )
    white = noise.reading
    share = share / share.sum() * len(white) / np.maximum(unit, 1e-300)
    mixed = noise.improved(shapes.total(share * float(np.mean(white))), white)
    square = moments.squares(mixed)
    levels = np.geomspace(1e-6, 1e3, 60)
    count, eigenvalue = moments.count[:, None], moments.eigenvalue[:, None]
    ratio = mixed.variance_at(moments.eigenvalue) - eigenvalue
    worth = [
        float(np.sum(-0.5 * count * np.log(v) - 0.5 * square / v))
        for v in (level * ratio + eigenvalue for level in levels)
    ]
    return share * float(np.mean(white)) * levels[int(np.argmax(worth))]

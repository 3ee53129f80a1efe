"""What the scores of a fit say: how much they scatter, and what it gains on other ticks.

Blocks of ticks are compared: the innovations factorise the likelihood over ticks, so that blocks of
one record may be split although the filter runs through.
"""

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.problem import Left
from orbitfb.physics.optics import Matrix

BLOCK = 25
"""Ticks of a block of the split, and of the variance of the scores."""
_NEARLY_NOTHING = 1e-6
"""Share of the prior's precision that holds values of which nothing is known."""
FEW_BLOCKS = 4.0
"""Of less, of like weight, no half of the blocks tells what the other may hold it to."""
_TIDY_BLOCKS = 8.0
"""Weight of the prior that scores scatter as the noise model says [blocks]."""


def by_row(white: Matrix, jacobian: Vector) -> Vector:
    """Log-likelihood of every row, up to a constant, shape (N,) [nats]."""
    return -0.5 * np.sum(white**2, axis=1) + jacobian


def inverse(curvature: Matrix, scale: Vector) -> Matrix:
    """Invert the curvature of k values, those of which hardly anything is known held by the prior.

    It is done in units of the priors: a radian and a logarithm are nowhere near each other.

    Args:
        curvature: Of the log-likelihood, negative, shape (k, k).
        scale: Widths of the priors, shape (k,).
    """
    units = np.outer(scale, scale)
    known = np.linalg.pinv(curvature * units + _NEARLY_NOTHING * np.eye(len(scale)))
    return np.asarray(known, dtype=np.float64) * units


def known_by_row(slopes: list[Left], inverse: Matrix) -> Vector:
    """Share that every row has in what is known of the values, shape (N,)."""
    shares = [
        inverse[i, j] * np.sum(a[0] * b[0], axis=1)
        for i, a in enumerate(slopes)
        for j, b in enumerate(slopes)
    ]
    return np.sum(shares, axis=0)


def inflation(rows: Matrix, inverse: Matrix, known: Vector) -> float:
    """Compare the scatter of the scores of blocks with what the curvature says.

    A few blocks that know everything say little about the scatter: as much as so many blocks of
    like weight would, against a prior of some blocks that scatter as they should.
    """
    blocks = len(rows) // BLOCK
    if blocks < 8:
        return 1.0
    sums = rows[: blocks * BLOCK].reshape(blocks, BLOCK, -1).sum(axis=1)
    sums -= sums.mean(axis=0)
    scatter = float(np.trace(inverse @ (sums.T @ sums))) / len(inverse)
    alike = telling(known)
    return max(1.0, (_TIDY_BLOCKS + alike * scatter) / (_TIDY_BLOCKS + alike))


def telling(known: Vector) -> float:
    """Count the blocks that tell of the values, as so many of like weight.

    Args:
        known: Share of every row in what is known of them, shape (N,).
    """
    blocks = len(known) // BLOCK
    weight = np.maximum(known[: blocks * BLOCK].reshape(blocks, BLOCK).sum(axis=1), 0.0)
    return float(np.sum(weight) ** 2 / max(float(np.sum(weight**2)), 1e-300))


def held_out(
    scale: Vector, now: Left, slopes: list[Left], rows: Matrix, gains: Vector
) -> tuple[Vector, Mask]:
    """Judge every row with values that come from the other half of the blocks.

    Args:
        scale: Widths of the priors of the k values, shape (k,).
        now: What is left at their best values.
        slopes: Its derivatives by each.
        rows: Scores of every row, shape (N, k).
        gains: Of every row at the best values, shape (N,) [nats].

    Returns:
        Gains of every row, shape (N,) [nats], and the values on which both halves disagree by more
        than 4 standard deviations, shape (k,).
    """
    even = (np.arange(len(rows)) // BLOCK) % 2 == 0
    moves: list[Vector] = []
    inverses: list[Matrix] = []
    for half in (even, ~even):
        curvature = np.array(
            [[np.sum(a[0][half] * b[0][half]) for b in slopes] for a in slopes]
        ) + 0.5 * np.array([[np.sum(a[1] * b[1]) for b in slopes] for a in slopes])
        inverses.append(inverse(curvature, scale))
        moves.append(inverses[-1] @ rows[half].sum(axis=0))
    held = gains.copy()
    _judge(held, ~even, now[0], slopes, moves[0])
    _judge(held, even, now[0], slopes, moves[1])
    spread = np.sqrt(np.maximum(np.diagonal(inverses[0] + inverses[1]), 1e-300))
    return held, np.abs(moves[0] - moves[1]) > 4.0 * spread


def _judge(
    held: Vector,
    half: Mask,
    white: Matrix,
    slopes: list[Left],
    move: Vector,
) -> None:
    change = np.zeros_like(white[half])
    for (slope, _, jacobian), length in zip(slopes, move, strict=True):
        change += slope[half] * length
        held[half] += jacobian[half] * length
    held[half] -= np.sum(change * (white[half] + 0.5 * change), axis=1)

"""Strikes that may follow each other: a chain whose states are how many there were in a row.

Every row is struck with probability p, whatever was before. What a strike does depends on how many
came before it without a break: where a value is held, the last one that arrived is further back.
So the state of a row is the length of the run that it ends, zero if it is not struck, and the sum
over all courses of the states is that of a hidden Markov chain (L. Rabiner, Proc. IEEE 77 (1989)
257, sections III A and B).
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.transform import Indices, Matrix

_MOST = 700.0
"""Largest logarithm of a ratio of likelihoods that is told apart [nats]: what a number can hold."""


def evidence_of_runs(gains: Matrix, shares: Vector) -> Vector:
    """Log evidence of strikes over none at all, for every probability, shape (S,).

    Args:
        gains: Log likelihood ratio of every row, if it ends a run of 1 … K strikes, to its not
            being struck, shape (K, T). A longer run counts as one of K.
        shares: Probabilities p, shape (S,).
    """
    longest, rows = gains.shape
    kept = np.clip(gains, -_MOST, _MOST)
    most = np.maximum(kept.max(axis=0), 0.0)
    ratio = np.exp(np.vstack([np.zeros(rows), kept]) - most)  # (K + 1, T)
    state = np.zeros((longest + 1, len(shares)))
    state[0] = 1.0
    total = np.full(len(shares), float(most.sum()))
    scale = np.ones_like(state)
    scale[0] = 1.0 - shares
    scale[1:] = shares
    for row in range(rows):
        struck = state[:-1].copy()
        struck[-1] += state[-1]
        state[1:] = struck
        state[0] = 1.0  # the states were scaled to one in all
        state *= scale
        state *= ratio[:, row, None]
        norm = state.sum(axis=0)
        state /= norm
        total += np.log(norm)
    return total


def likeliest_runs(gains: Matrix, share: float) -> Indices:
    """Length of the run that every row ends in the most likely course, 0: not struck, shape (T,).

    Args:
        gains: As for `evidence_of_runs`, shape (K, T).
        share: Probability p.
    """
    longest, rows = gains.shape
    best = np.full(longest + 1, -np.inf)
    best[0] = 0.0
    came = np.zeros((rows, longest + 1), dtype=np.intp)
    struck, spared = float(np.log(share)), float(np.log1p(-share))
    for row in range(rows):
        before = np.arange(-1, longest)
        before[0] = int(np.argmax(best))
        if best[-1] > best[-2]:
            before[-1] = longest
        came[row] = before
        best = best[before]
        best[0] += spared
        best[1:] += struck + gains[:, row]
    runs = np.zeros(rows, dtype=np.intp)
    state = int(np.argmax(best))
    for row in reversed(range(rows)):
        runs[row] = state
        state = int(came[row, state])
    return runs

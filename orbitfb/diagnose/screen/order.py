"""Columns of the orbit, or of the setpoints, that are not in the order of their names.

BPMs in another order read what the model says of other rows, correctors in another order act as
other columns of it. Whichever order of either explains the steps best is looked for, and the two
are compared: a turn of the correctors by one looks a good deal like a turn of the BPMs by one.
Where neither explains much more than the other, it is only said that one of them is wrong.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.steps import SURE, Steps, likelier, one_way
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.finding import Finding

_EXPLAINED = 0.7
_MANY = 0.2
_HARDLY = 0.9
_FEWEST_CHANNELS = 4
_LEAST_MOVED = 3
_STEPS = 60
"""Most steps towards the best order; it is mostly found in fewer than ten."""
_SWAPS = 3
"""Most swaps of two after that, times the number of correctors."""
_CONVERGED = 1e-6
_TINY = 1e-300


def check_order(steps: Steps, response: Matrix) -> list[Finding]:
    """Tell columns of the orbit or of the setpoints that are in another order than the model's.

    Args:
        steps: Of the record, the largest scaled down.
        response: Of the model, shape (n, m) [m/A].
    """
    if one_way(steps):
        return []
    n, m = response.shape
    bpms = _bpms_elsewhere(steps, response)
    order, left = best_order(steps, response)
    correctors = int((order != np.arange(m)).sum())
    if not bpms and not correctors:
        return []
    better = float(np.sum(likelier(len(steps.first), _left_by_bpms(steps), left))) / np.sqrt(n)
    if better > SURE and correctors:
        text = (
            f"{correctors} of {m} corrector columns act as the model predicts for others: the "
            "columns of 'setpoint' (and 'action') are not in the order of corr_names and model_R; "
            "put them, or the names and the columns of model_R, in one order"
        )
    elif better < -SURE and bpms:
        text = (
            f"{bpms} of {n} BPM columns read what the model predicts for others: columns of "
            "'orbit' are not in the order of bpm_names and model_R"
        )
    else:
        text = (
            "the orbit follows the setpoints as if devices were in another order: either the "
            "columns of 'orbit' are not in the order of bpm_names and the rows of model_R, or "
            "those of 'setpoint' are not in the order of corr_names and the columns of model_R; "
            "this record does not show which of the two"
        )
    return [Finding("permuted-channels", "failure", (), None, text)]


def _bpms_elsewhere(steps: Steps, response: Matrix) -> int:
    """Count the BPMs that follow the model of other BPMs; 0 when they are too few to tell."""
    likeness = _likeness(steps)
    own, best = np.diag(likeness), likeness.max(axis=1)
    left, otherwise = 1 - own * np.abs(own), 1 - np.minimum(best, 0.999999) ** 2
    seen = np.sum(steps.orbit**2, axis=0)
    scaled = _left_by_gains(steps, response)
    left = np.minimum(left, np.divide(scaled, seen, out=np.ones_like(seen), where=seen > 0))
    elsewhere = likelier(len(steps.first), left, otherwise) > SURE
    elsewhere &= own < _HARDLY * best  # one large error makes BPMs follow others a little better
    n = len(own)
    if n < _FEWEST_CHANNELS or elsewhere.sum() < max(_LEAST_MOVED, _MANY * n):
        return 0
    targets = likeness.argmax(axis=1)[elsewhere]
    return int(elsewhere.sum()) if len(np.unique(targets)) > _EXPLAINED * len(targets) else 0


def _likeness(steps: Steps) -> Matrix:
    """Correlation of the step of every BPM with what the model says of every other, (n, n)."""
    seen = np.sqrt(np.sum(steps.orbit**2, axis=0))
    made = np.sqrt(np.sum(steps.predicted**2, axis=0))
    scale = np.outer(np.where(seen > 0, seen, np.inf), np.where(made > 0, made, np.inf))
    return (steps.orbit.T @ steps.predicted) / scale


def _left_by_bpms(steps: Steps) -> Vector:
    """Squares that the best order of the BPMs leaves at every one, shape (n,) [m²]."""
    seen, made = np.sum(steps.orbit**2, axis=0), np.sum(steps.predicted**2, axis=0)
    left = seen[:, None] - 2 * steps.orbit.T @ steps.predicted + made[None, :]
    left = np.maximum(left, _TINY)
    return left[linear_sum_assignment(np.log(left))]


def best_order(steps: Steps, response: Matrix) -> tuple[Indices, Vector]:
    """Find which column of the model every corrector acts as, if that explains much.

    Mixtures of orders are a convex set, on which the squares that are left have one least value:
    it is approached by steps towards the order that promises most (Frank and Wolfe, 1956). A
    lower bound of it comes with each, so that where no order can explain much this ends early.
    The nearest order is then improved by swaps of two.

    Args:
        steps: Of the record.
        response: Of the model, shape (n, m) [m/A].

    Returns:
        Column of the model for every corrector, shape (m,), as it is where none is convincing;
        and the squares that this order leaves at every BPM, shape (n,) [m²].
    """
    m = response.shape[1]
    as_is = np.arange(m)
    seen = np.sum(steps.orbit**2, axis=0)
    own = np.sum((steps.orbit - steps.predicted) ** 2, axis=0)
    if m < _FEWEST_CHANNELS or not seen.any():
        return as_is, own
    # Against a gain of its own of every BPM or corrector, so that wrong gains are no other order.
    made = np.sum(steps.predicted**2, axis=0)
    along = np.sum(steps.orbit * steps.predicted, axis=0)
    slope = np.divide(along, made, out=np.zeros_like(made), where=made > 0)
    weights = np.divide(1.0, seen, out=np.zeros_like(seen), where=seen > 0)
    rest = np.minimum(own, seen - slope * along)
    rest = np.maximum(np.minimum(rest, _left_by_gains(steps, response)), 0.0)
    order = _approached(steps, response, weights, _EXPLAINED * float(rest @ weights))
    if order is None or (order != as_is).sum() < max(_LEAST_MOVED, _MANY * m):
        return as_is, own
    left = np.sum((steps.orbit - steps.setpoints @ response[:, order].T) ** 2, axis=0)
    gain = float(np.sum(likelier(len(steps.first), rest, left))) / np.sqrt(len(own))
    convincing = float(np.median(left / np.where(rest > 0, rest, _TINY))) < _EXPLAINED
    return (order, left) if gain > SURE and convincing else (as_is, own)


def _left_by_gains(steps: Steps, response: Matrix) -> Vector:
    """Squares left at every BPM where each corrector has a gain of its own, shape (n,) [m²].

    One that stands still or kicks the other way leaves so much that another order would leave less.
    """
    seen = np.sum(steps.orbit**2, axis=0)
    weights = np.divide(1.0, seen, out=np.zeros_like(seen), where=seen > 0)
    moves = steps.setpoints.T @ steps.setpoints
    known = moves * (response.T @ (weights[:, None] * response))
    pull = np.einsum("kj,kj->j", steps.setpoints, (steps.orbit * weights) @ response)
    gains = np.linalg.lstsq(known, pull, rcond=None)[0]
    return np.sum((steps.orbit - (steps.setpoints * gains) @ response.T) ** 2, axis=0)


def _approached(steps: Steps, response: Matrix, weights: Vector, enough: float) -> Indices | None:
    """Approach the best order; None once it is sure that every one leaves more than `enough`."""
    moves = steps.setpoints.T @ steps.setpoints
    overlap = response.T @ (weights[:, None] * response)
    pull = ((steps.setpoints.T @ steps.orbit) * weights) @ response
    whole = float(np.sum(steps.orbit**2 @ weights))
    m = len(moves)
    mixture = np.full((m, m), 1.0 / m)
    for _ in range(_STEPS):
        mixed = moves @ mixture @ overlap
        slope = mixed - pull
        towards = -mixture
        towards[linear_sum_assignment(slope)] += 1.0
        promised = -float(np.sum(slope * towards))
        left = whole + float(np.sum(mixture * (mixed - 2.0 * pull)))
        if left - 2.0 * promised > enough:
            return None
        if promised < _CONVERGED * whole:
            break
        bend = float(np.sum((moves @ towards @ overlap) * towards))
        mixture = mixture + (min(1.0, promised / bend) if bend > 0 else 1.0) * towards
    return _polished(linear_sum_assignment(-mixture)[1], moves, overlap, pull)


def _polished(order: Indices, moves: Matrix, overlap: Matrix, pull: Matrix) -> Indices:
    """Swap the two columns of an order that help most, as long as any help.

    Args:
        order: Column of the model for every corrector, shape (m,).
        moves: Products of the steps of the setpoints, shape (m, m) [A²].
        overlap: Weighted products of the columns of the model, shape (m, m) [1/A²].
        pull: Of the orbit's steps on every corrector as every column, shape (m, m).
    """
    order = order.copy()
    rest = pull - moves[:, np.argsort(order)] @ overlap
    travel = _apart(moves)
    for _ in range(_SWAPS * len(order)):
        own = rest[:, order]
        helped = own + own.T - np.diag(own)[:, None] - np.diag(own)[None, :]
        gain = 2.0 * helped - travel * _apart(overlap[np.ix_(order, order)])
        j, k = (int(i) for i in np.unravel_index(np.argmax(gain), gain.shape))
        if gain[j, k] <= _CONVERGED * abs(float(np.sum(np.diag(pull[:, order])))):
            break
        change = overlap[order[k]] - overlap[order[j]]
        rest -= np.outer(moves[:, j] - moves[:, k], change)
        order[[j, k]] = order[[k, j]]
    return order


def _apart(products: Matrix) -> Matrix:
    """Squared distance of every two vectors, of their products, shape (m, m)."""
    size = np.diag(products)
    return size[:, None] - 2.0 * products + size[None, :]

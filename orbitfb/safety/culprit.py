"""Does one corrector alone explain that the orbit does not answer as the response matrix says?

A wrong sign or exchanged BPMs spoil the answer to every corrector. One that does nothing, or the
wrong thing, spoils what lies along its own column r of the response: without that direction the
orbit answers as predicted. So with Δd seen and Δp predicted (`prediction`), both made orthogonal to
r, the share c = Δd · Δp / Δp² is 1 for the culprit, and as bad as before for all others.
"""

from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.prediction import Answers

APART = 0.35
"""How far the share of the others may be from 1: half of what lies between 1, which a response that
is right shows, and the 0.3 of `prediction_least`. What is left may not exceed the prediction."""


def culprit(
    position: Vector,
    valid: Mask,
    answers: Answers,
    response: Vector,
    ours: Mask,
    settings: InterlockSettings,
) -> int | None:
    """Find the corrector without which the orbit answers as predicted.

    Args:
        position: The orbit, shape (n,) [m].
        valid: BPMs that count, shape (n,).
        answers: What was predicted and seen before it.
        response: R, shape (n, m) [m/A].
        ours: Correctors that the loop moves, shape (m,).
        settings: Thresholds.

    Returns:
        Its index; None: no single one explains it.
    """
    before, step, counted = answers.position, answers.step, answers.valid
    if before is None or step is None or counted is None or not answers.predicted:
        return None
    counts = valid & counted
    change = (position - before - step)[counts]
    sent = (*answers.predicted, np.zeros_like(answers.predicted[0]))
    best, least = None, np.inf
    for newer, older in list(pairwise(sent))[: settings.readback_lag + 1]:
        expected = (newer - older)[counts]
        found = _explains(change, expected, response[counts], ours, settings.prediction_floor)
        if found is not None and found[1] < least:
            best, least = found
    return best


def _explains(
    change: Vector, expected: Vector, response: Vector, ours: Mask, floor: float
) -> tuple[int, float] | None:
    """Give the best culprit and what it leaves unexplained [m²]; None: there is none."""
    sizes = np.sqrt(np.sum(response**2, axis=0))
    units = response / np.where(sizes > 0, sizes, np.inf)
    along, wanted = change @ units, expected @ units
    power = expected @ expected - wanted**2
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (change @ expected - along * wanted) / power
    left = np.sum((change - expected) ** 2) - (along - wanted) ** 2
    good = ours & (power >= len(change) * floor**2) & (np.abs(share - 1.0) <= APART)
    good &= left <= power
    if not good.any():
        return None
    index = int(np.argmin(np.where(good, left, np.inf)))
    return index, float(left[index])

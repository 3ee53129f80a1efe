"""Look between the values of a grid: a limit may be sharper than any grid is dense.

A change cannot gain more than its score, and the score falls off from the true value less sharply
than the gain. Where a few large steps tell it all, values a fifth apart may both be worse than
nothing, and their scores still point to what is between them.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np

from orbitfb.effects.kinds import EffectKind, Values

_LEAST = 50.0
"""Score from which it is worth the time [nats]."""
_LOOKS = 5
_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0

Heights = Mapping[str, float]
"""Best score by what is struck: one place, or all of a cell."""


def between(
    kind: EffectKind,
    grid: Sequence[Values],
    heights: Sequence[Heights],
    height: Callable[[Values], Heights],
) -> Iterator[Values]:
    """Find values between those of a grid where the scores are highest, by golden sections.

    Args:
        kind: Whose values they are; only one of its parameters, known by order of magnitude,
            may vary in the grid. Nothing is found for others.
        grid: Values that were looked at.
        heights: Their scores.
        height: Tells those of any values.
    """
    varied = [p for p in kind.parameters if len({values[p.name] for values in grid}) > 1]
    if kind.linear is not None or len(varied) != 1 or not varied[0].log:
        return
    name = varied[0].name
    order = np.argsort([values[name] for values in grid])
    places = np.log([grid[int(i)][name] for i in order])
    for what in heights[0]:
        scores = np.array([heights[int(i)][what] for i in order])
        top = int(np.argmax(scores))
        if scores[top] < _LEAST:
            continue

        def score(place: float, what: str = what) -> float:
            return height({**grid[0], name: float(np.exp(place))})[what]

        low, high = places[max(top - 1, 0)], places[min(top + 1, len(places) - 1)]
        yield {**grid[0], name: float(np.exp(_highest(score, low, high)))}


def _highest(score: Callable[[float], float], low: float, high: float) -> float:
    """Where a function with one top between two places is highest, nearly."""
    left, right = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
    on_left, on_right = score(left), score(right)
    for _ in range(_LOOKS - 2):
        if on_left > on_right:
            high, right, on_right = right, left, on_left
            left = high - _GOLDEN * (high - low)
            on_left = score(left)
        else:
            low, left, on_left = left, right, on_right
            right = low + _GOLDEN * (high - low)
            on_right = score(right)
    return left if on_left > on_right else right

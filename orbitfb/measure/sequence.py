"""The steps of one corrector: bipolar, of several sizes, blind to what drifts."""

import numpy as np

from orbitfb.core.signals import Vector

BLIND = (1.0, -1.0, -1.0, 1.0)
"""Signs whose sum is 0, and whose sum weighted by their order too."""


def levels(sizes: int, repeats: int) -> Vector:
    """Give the levels in their order.

    Every size is taken with the signs + − − +, which a constant and a linear drift leave no
    trace in; every other time all signs are turned, so that a quadratic one leaves less.

    Args:
        sizes: Sizes of step, evenly spaced up to 1.
        repeats: Times that all of it is done.

    Returns:
        Shape (4 sizes repeats,), from −1 to 1: parts of the amplitude.
    """
    steps = np.arange(1, sizes + 1) / sizes
    quartets = np.tile(steps, repeats)[:, None] * np.array(BLIND)
    quartets[1::2] *= -1.0
    return quartets.ravel()

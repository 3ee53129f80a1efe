"""The middle and the scatter of numbers of which a few are wild."""

import numpy as np

from orbitfb.core.signals import Vector

TO_SIGMA = 1.4826
"""Standard deviation of normal numbers over the median of their sizes [1]: 1 / Φ⁻¹(3/4)."""


def median(values: Vector) -> float:
    """Give the median as `numpy.median` does, for a few hundred numbers at a fifth of its price.

    Args:
        values: Shape (n,), at least one; NaN if one of them is.
    """
    ordered = np.sort(values)
    last, middle = float(ordered[-1]), len(ordered) // 2
    if last != last:  # NaN is sorted to the end
        return last
    if len(ordered) % 2:
        return float(ordered[middle])
    return float((ordered[middle - 1] + ordered[middle]) / 2.0)

"""How unlikely a sum of squares is."""

import numpy as np
from scipy.special import gammaln
from scipy.stats import chi2


def surprise(squares: float, count: int) -> float:
    """−log of the chance that so many squares of normal numbers sum to more [nats].

    Args:
        squares: Their sum.
        count: Of them, at least 1.
    """
    if (chance := float(chi2.sf(squares, count))) > 0.0:
        return -float(np.log(chance))
    # Below the smallest number that there is: the first terms of the continued fraction of the
    # incomplete Γ function (M. Abramowitz and I. A. Stegun, 6.5.31).
    size, half = 0.5 * squares, 0.5 * count
    return float(size - half * np.log(size) + gammaln(half) + np.log(size + 1.0 - half))

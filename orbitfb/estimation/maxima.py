"""Where a function of one value, or of several, is highest."""

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import fminbound, minimize

from orbitfb.core.signals import Vector
from orbitfb.estimation.priors import BEND, FINENESS, KNOWN_TO

_SIMPLEX = 0.2
"""Change of each logarithm with which several values are sought at once."""
_LOOKS = 80
"""Values that are tried while they are, at most. By hand, for time: two values take about 40."""
_NEARLY = 0.1
"""Evidence to which the best of them is found [nats]."""


def nearby(worth: Callable[[float], float], value: float, reach: float) -> tuple[float, float]:
    """The best value near one of a grid, and its relative standard deviation by the curvature.

    Args:
        worth: Log likelihood of a value.
        value: Of the grid.
        reach: Factor by which the best one differs at most.
    """
    best = value * highest(lambda factor: worth(value * factor), (1.0 / reach, reach), FINENESS)
    best = best if worth(best) > worth(value) else value
    bent = (2.0 * worth(best) - worth(best * (1.0 + BEND)) - worth(best * (1.0 - BEND))) / BEND**2
    return best, 1.0 / float(np.sqrt(max(bent, 0.0) + 1.0 / KNOWN_TO**2))


def highest_of(
    worth: Callable[[Mapping[str, float]], float],
    begin: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]],
) -> dict[str, float]:
    """Where a function of several values is highest near others, along their logarithms.

    Args:
        worth: The function.
        begin: Values, all above zero.
        bounds: Least and largest of each.
    """

    def values(logs: Vector) -> dict[str, float]:
        each = zip(begin, np.exp(logs).tolist(), strict=True)
        return {name: min(max(one, bounds[name][0]), bounds[name][1]) for name, one in each}

    logs = np.log(list(begin.values()))
    return values(climbed(lambda at: worth(values(at)), logs, _SIMPLEX))


def climbed(worth: Callable[[Vector], float], begin: Vector, step: float) -> Vector:
    """Where a function of several numbers is highest near others.

    J. A. Nelder, R. Mead, Comput. J. 7 (1965) 308.

    Args:
        worth: The function [nats].
        begin: The numbers, shape (k,).
        step: By which each is changed at first.
    """
    corners = np.vstack([begin, begin + step * np.eye(len(begin))])
    options = {"initial_simplex": corners, "xatol": FINENESS, "fatol": _NEARLY, "maxfev": _LOOKS}
    found = minimize(lambda at: -worth(at), begin, method="Nelder-Mead", options=options)
    return np.asarray(found.x)


def highest(worth: Callable[[float], float], ends: tuple[float, float], fine: float) -> float:
    """Where a function is highest between two values, along their logarithm if they have one.

    Args:
        worth: The function.
        ends: Between them.
        fine: To which share of their distance.
    """
    bend, back = (np.log, np.exp) if ends[0] > 0.0 else (np.asarray, np.asarray)
    span = float(bend(ends[0])), float(bend(ends[1]))

    def loss(bent: float) -> float:
        return -worth(float(back(bent)))

    found = fminbound(loss, *span, xtol=fine * (span[1] - span[0]), full_output=False)
    return float(back(float(np.asarray(found))))

"""How far a planned excitation drives two suspects apart.

Two suspects are as far apart as the best values of the second leave them:

    D = min_θ ½ (δ_A − δ_B(θ))ᵀ Ω (δ_A − δ_B(θ))

which is the expected log-likelihood ratio if A is true (T-optimal discrimination: A. C. Atkinson
and V. V. Fedorov, Biometrika 62 (1975) 57). Ω is the floor of the record at hand with the healthy
errors marginalised; δ_B is linear around the values that the record gives B.
"""

import numpy as np

from orbitfb.diagnose.experiments.outlook import Outlook
from orbitfb.diagnose.experiments.suspects import Suspect, change_of

_KNOWN_TO = 1.0
"""Relative standard deviation of a value of the second before the experiment [1]: a rival's values
are anything that fits."""


def separation(view: Outlook, first: Suspect, second: Suspect | None) -> float:
    """Give the expected log-likelihood ratio of two suspects, if the first one is true [nats].

    Args:
        view: What the excitation would show.
        first: With its values.
        second: Its values are those around which it is free; None: no effect.

    Returns:
        Zero where one of them says nothing of the orbit.
    """
    own = change_of(first, view.signals, view.transform)
    if own is None:
        return 0.0
    if second is None:
        return 0.5 * max(float(view.told([own.field])[0, 0]), 0.0)
    rival = change_of(second, view.signals, view.transform)
    if rival is None:
        return 0.0
    told = view.told([own.field - rival.field, *rival.free])
    cross, free = told[0, 1:], told[1:, 1:]
    inner = free + np.eye(len(free)) / _KNOWN_TO**2
    taken = float(cross @ np.linalg.solve(inner, cross)) if len(free) else 0.0
    return 0.5 * max(float(told[0, 0]) - taken, 0.0)

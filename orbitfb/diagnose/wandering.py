"""An orbit of one shape that walks: told from the floor by the modes that it is made of.

Every mode of the floor has a level of its own, so a floor that is estimated with the record takes
over what walks in a few modes alone, as the dispersion does. What it cannot explain is why just
these modes walk so much more than their neighbours, and in the ratio of the shape. So the levels
of these modes are uncertain about those of their neighbours, under both hypotheses, and summed
over: log ∫ L(q + κ b²) p(q) dq of each, less the same at κ = 0.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import explain
from orbitfb.diagnose.floor import LADDER, evidence
from orbitfb.physics.places import Indices

_WHOLE = 0.99
"""Share of the shape that its modes have together."""
_MOST = 8
"""Modes beyond which the floor leaves the shape to be seen by itself."""
_NEIGHBOURS = 6
_SCATTER = 1.0
"""Scatter of a mode's level, in its logarithm, about those of its neighbours."""
_STEPS = np.exp(np.linspace(-8.0, 8.0, 65))
"""Sizes tried, in units of the walk of the neighbours."""


class Wandering:
    """How likely walks of one shape are, beside a floor that was estimated with the record.

    Args:
        bench: The record under the causes so far.
        shape: Orbit of size 1, shape (n,) [m per unit].

    Attributes:
        seen: Whether the shape is made of few modes; else the floor does not hide it.
    """

    def __init__(self, bench: Bench, shape: Vector) -> None:
        floor, record = bench.floor, bench.record
        power = (floor.modes.directions.T @ shape) ** 2
        order = np.argsort(power)[::-1]
        count = int(np.searchsorted(np.cumsum(power[order]), _WHOLE * power.sum())) + 1
        own = order[:count]
        self.seen = count <= _MOST
        self._power = power[own] / floor.reading
        levels = np.log(np.maximum(floor.walk / floor.reading, LADDER[0]))
        self._expected = np.array([_around(levels, int(mode), own) for mode in own])
        if self.seen:
            left = explain(record, bench.causes, bench.orbit).left
            left = left - bench.background.orbit(bench.sizes)
            squares, logs, _ = evidence(left @ floor.modes.directions[:, own], record.starts)
            self._height = -0.5 * (squares / floor.reading + logs[:, None])
            self._nothing = self._marginal(0.0)

    def gain(self, variance: float) -> float:
        """Gain of a walk of this variance per tick, against none [nats]."""
        return self._marginal(variance) - self._nothing

    def best(self) -> tuple[float, float]:
        """Variance per tick that gains most, and what it gains [nats]."""
        usual = float(np.exp(np.mean(self._expected - np.log(self._power))))
        gains = [self.gain(usual * step) for step in _STEPS]
        top = int(np.argmax(gains))
        return usual * float(_STEPS[top]), gains[top]

    def _marginal(self, variance: float) -> float:
        places = np.log(LADDER)
        total = 0.0
        for mode, power in enumerate(self._power):
            prior = -0.5 * ((places - self._expected[mode]) / _SCATTER) ** 2
            there = np.log(LADDER + variance * power)
            height = np.interp(there, places, self._height[:, mode])
            total += float(np.logaddexp.reduce(height + prior) - np.logaddexp.reduce(prior))
        return total


def _around(levels: Vector, mode: int, own: Indices) -> float:
    """Typical logarithm of a level among the neighbours of a mode that are not of the shape."""
    first = max(mode - _NEIGHBOURS, 0)
    near = [k for k in range(first, min(mode + _NEIGHBOURS + 1, len(levels))) if k not in own]
    return float(np.median(levels[near])) if near else float(levels[mode])

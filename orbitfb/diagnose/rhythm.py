"""Whether what strikes at random times does so, or by a clock.

Events of a chance p per tick are geometrically far from each other. What is done by a clock (a
top-up shot, a pulsed magnet, a task that runs every so many ticks) comes after the same number of
ticks each time.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.strikes import struck_rows
from orbitfb.diagnose.switching import states_of
from orbitfb.effects.random_kinds import LatentKind

_FEW = 4
"""Lengths, at least, that tell whether they are all the same."""
_WIDTHS = (0, 1, 3)
"""Ticks by which the lengths of a clock may differ from the usual one."""
_OTHERS = 0.1
"""Share of lengths that are something else: an event that was not seen."""


def rhythm(bench: Bench, cause: Cause) -> float:
    """What a clock explains of the times at which a cause strikes, less its price [nats].

    Args:
        bench: The record under the causes before it.
        cause: A source that switches, or what strikes in single rows; nothing is told of others.
    """
    rows = len(bench.record)
    if isinstance(cause.kind, LatentKind):
        if cause.kind.strength == "normal":
            return 0.0  # it strikes at every tick, and shows at those at which the orbit moves
        struck = struck_rows(bench, cause.kind, cause)
        return regular(np.diff(np.flatnonzero(struck)), rows)
    states = states_of(bench, cause)
    if states is None:
        return 0.0
    edges = np.flatnonzero(np.diff(states)) + 1
    lengths, state = np.diff(edges), states[edges[:-1]]
    return sum(regular(lengths[state == sign], rows) for sign in (1.0, -1.0))


def regular(lengths: Vector, rows: int) -> float:
    """What it tells that times between events are all the same [nats]; 0 if they are not.

    Args:
        lengths: From event to event, shape (K,) [ticks].
        rows: Among which the length was chosen.
    """
    if len(lengths) < _FEW or lengths.mean() <= 1.0:
        return 0.0
    chance = 1.0 / float(lengths.mean())
    alone = np.log(chance) + (lengths - 1.0) * np.log1p(-chance)
    away = np.abs(lengths - np.median(lengths))
    gains: list[float] = []
    for width in _WIDTHS:
        inside = np.where(away <= width, np.log((1.0 - _OTHERS) / (2 * width + 1)), -np.inf)
        gains.append(float(np.sum(np.logaddexp(inside - alone, np.log(_OTHERS)))))
    return max(max(gains) - float(np.log(rows * len(_WIDTHS))), 0.0)

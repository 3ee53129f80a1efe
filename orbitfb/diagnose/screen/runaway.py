"""Rows in which the loop has run away.

Healthy errors are told to first order. What that neglects grows with the orbit that the correctors
make, until it shows: then whatever is wrong by another pattern is likelier than the true cause. A
loop that runs away does that by itself, as one with exchanged BPMs does, and goes on until the beam
is lost. Its first rows say what was wrong, and the last ones are left out.
"""

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import HEALTHY_CHANGE
from orbitfb.estimation.priors import FIRST_ORDER
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record

_SHOWN = 1.0 / 3.0
"""Share of the noise of a reading from which what is neglected shows [1]. By hand: every row and
every BPM of a loop that runs away is wrong in the same way."""

_GROWS = 0.9
"""Share of rows that are further away than all before from which a loop runs away [1]. By hand: a
walk has few of them, and a step of the reference orbit one."""

_FEWEST = 100
"""Rows before that are left, at least. By hand: fewer hardly tell noise from motion."""


def without_runaway(record: Record) -> tuple[Record, list[Finding]]:
    """Leave out the rows in which the loop has run away.

    Args:
        record: The record.

    Returns:
        The record without them, and what was found.
    """
    away = _away(record)
    near = np.flatnonzero(away <= _SHOWN * _noise(record) / (FIRST_ORDER * HEALTHY_CHANGE))
    first = int(near[-1]) + 1 if len(near) else 0
    furthest = np.maximum.accumulate(away)
    growing = np.count_nonzero(away[first:] >= furthest[first:])
    if first < _FEWEST or growing < max(_GROWS * len(away[first:]), 1):
        return record, []
    text = (
        f"the loop runs away: from row {first} on the correctors move the orbit by more than "
        f"{1e6 * float(away[first]):.3g} µm (rms of all BPMs). Rows {first} to {len(away) - 1} are "
        "left out: so far away, small errors of the model hide the cause"
    )
    finding = Finding("runaway", "warning", (), (first, len(away) - 1), text)
    return record.rows(0, first), [finding]


def _away(record: Record) -> Vector:
    """How far the correctors have moved the orbit since the first row, rms, shape (N,) [m]."""
    moved = (record.setpoints - record.setpoints[0]) @ record.layout.response.T
    return np.asarray(np.sqrt(np.mean(moved**2, axis=1)))


def _noise(record: Record) -> float:
    """Noise of a reading, the median of all BPMs; more where the orbit walks fast [m]."""
    left = record.readings - record.setpoints @ record.layout.response.T
    steps = np.diff(left, axis=0)[~record.starts[1:]]
    return TO_SIGMA * float(np.median(np.median(np.abs(steps), axis=0))) / np.sqrt(2.0)

"""The record of a running loop: its last ticks, cut at jumps of the orbit."""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.core.transitions import Transitions
from orbitfb.records.layout import Layout
from orbitfb.records.reading.stretches import Transition, join
from orbitfb.records.record import Record

FEWEST = 200
"""Fewest ticks for a look."""

_JUMP = 10.0
"""Distance of a jump above the median step, in units of the distance from the median to the upper
quartile. Of squares of one normal number one in 400 lies beyond; of sums of 180 squares, less than
one in 10¹⁰."""

_BY_NOBODY = 4.0
"""Smallest ratio of a jump to the motion by the correctors in this row or the one before. A
corrector with the wrong sign makes a step of twice its motion, which is not a jump."""

_MOST_JUMPS = 0.01
"""Largest share of ticks that may be jumps [1]. If there are more, jumps are usual on this ring."""


def record_of(transitions: Transitions, layout: Layout) -> Record | None:
    """Make a record of the closed, usable transitions; None if there are too few.

    Args:
        transitions: Transitions of the loop.
        layout: Layout of all its channels.
    """
    transitions = transitions.by_correctors()
    usable = transitions.usable & transitions.closed & np.isfinite(transitions.time)
    usable &= np.isfinite(transitions.setpoints).all(axis=1)
    usable &= np.isfinite(transitions.orbit).any(axis=1)
    if int(usable.sum()) < FEWEST:
        return None
    rows = Transition(
        time=transitions.time,
        orbit=transitions.orbit,
        next_orbit=transitions.next_orbit,
        setpoints=transitions.setpoints,
        requested=transitions.applied,
        follows=~transitions.starts()[1:],
        readback=None,
        dither=transitions.dither,
        reference=transitions.reference,
        auxiliary={
            name: values
            for name, values in transitions.auxiliary.items()
            if np.isfinite(values[usable]).all()
        },
    ).take(usable)
    return join(rows, layout, "the last ticks of the service")[0]


def cut_at_jumps(record: Record) -> Record:
    """Begin a new stretch where the orbit jumps and no corrector was the reason.

    A kick by an operator, a magnet that steps or a glitch of all BPMs is a single event, and not an
    error of the model. A stretch starts from its own first row, so the step itself is not tested;
    the response of the feedback to it is.
    """
    jumps = _jumps(record)
    return replace(record, starts=record.starts | jumps) if np.any(jumps) else record


def _jumps(record: Record) -> Mask:
    """Find the rows whose step is far larger than usual, shape (N,)."""
    made = record.setpoints @ record.layout.response.T
    left = record.readings - made
    inside = np.flatnonzero(~record.starts)
    steps = left[inside] - left[inside - 1]
    usual = np.median(steps**2, axis=0)
    seen = usual > 0.0
    jumps = np.zeros(len(record), dtype=np.bool_)
    if not np.any(seen):
        return jumps
    size = np.sum(steps[:, seen] ** 2 / usual[seen], axis=1)
    middle, upper = np.quantile(size, (0.5, 0.75))
    moved = np.sqrt(np.mean(np.diff(made, axis=0, prepend=made[:1]) ** 2, axis=1))
    moved = np.maximum(moved, np.append(0.0, moved[:-1]))[inside]
    alone = np.sqrt(np.mean(steps**2, axis=1)) > _BY_NOBODY * moved
    jumps[inside[alone & (size > middle + _JUMP * (upper - middle))]] = True
    return jumps if jumps.sum() <= _MOST_JUMPS * len(record) else np.zeros_like(jumps)

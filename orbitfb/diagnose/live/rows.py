"""The record of a running loop: its last ticks, cut where the orbit jumped."""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.core.transitions import Transitions
from orbitfb.records.layout import Layout
from orbitfb.records.reading.stretches import Transition, join
from orbitfb.records.record import Record

FEWEST = 200
"""Ticks below which nothing is said."""

_JUMP = 10.0
"""How far a step of the orbit must lie above the median one to be a jump, in distances from the
median to the upper quartile: of the sum of squares of one normal number one in 400 does, of that of
180 of them none of 10¹⁰."""

_BY_NOBODY = 4.0
"""How many times as large as what the correctors do at that row, or did at the one before, a step
must be that they did not make: one that kicks the wrong way leaves twice what it should do."""

_MOST_JUMPS = 0.01
"""Share of the ticks that may be jumps: more of them are no single events, but how this ring
moves [1]."""


def record_of(transitions: Transitions, layout: Layout) -> Record | None:
    """Make a record of the closed, usable transitions; None when there are too few.

    Args:
        transitions: Of the loop.
        layout: Of all its channels.
    """
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
    """Begin a stretch wherever the whole orbit jumps by what no corrector did.

    A kick by an operator, a magnet that steps, a glitch of all BPMs: each is one event of the
    machine, and says nothing against the model. A stretch knows the orbit only from its own first
    row on, so the step is not judged; what the feedback does about it is.
    """
    jumps = _jumps(record)
    return replace(record, starts=record.starts | jumps) if np.any(jumps) else record


def _jumps(record: Record) -> Mask:
    """Rows whose step is far larger than usual, shape (N,)."""
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

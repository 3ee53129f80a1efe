"""Lone spikes: single readings that are far from those before and after, as every BPM has some.

A spike says nothing of machine or model, and would be taken for noise of a BPM. It is left out: the
mean of its neighbours, less what the model says of them, stands for it. More than a few are no
spikes but noise with tails, which is an effect; one that many BPMs share is motion of the beam.
"""

import math
from dataclasses import replace

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Mask
from orbitfb.diagnose.screen.repeats import unread
from orbitfb.estimation.transform import Matrix
from orbitfb.records.finding import Finding, counted, listed
from orbitfb.records.record import Record

FAR = 15.0
"""Distance from the neighbours over its usual size from which a reading is a spike [1]: never by
chance (e^−112), and beyond what the tails of noise that are an effect have as a rule."""

LONE = 1e-3
"""Share of its readings that are spikes of a BPM by nature, at most [1]. By hand."""

TAILS = 1e-2
"""The same for noise with tails, which is an effect [1]. By hand."""

SHARED = 0.05
"""Share of the BPMs at which one row may have spikes [1], but one in any case. By hand: what moves
the beam is seen by most of them."""

ALONE = 0.25
"""Least part of a spike that its neighbours must not have [1]: else it is a step or a ramp."""


def without_spikes(record: Record) -> tuple[Record, list[Finding]]:
    """Leave lone spikes out.

    Args:
        record: The record.

    Returns:
        The record without them, and what was found.
    """
    left = record.readings - record.setpoints @ record.layout.response.T
    between = _between(left, record)
    spikes = _spikes(left - between, left, record) & ~_beside_unread(record)
    if not spikes.any():
        return record, []
    readings = np.where(spikes, record.readings - left + between, record.readings)
    rows, columns = np.nonzero(spikes)
    labels = [record.layout.bpms.label(int(column)) for column in dict.fromkeys(columns.tolist())]
    at = ", ".join(str(row) for row in rows[:5].tolist()) + (" …" if len(rows) > 5 else "")
    text = (
        f"{counted(len(rows), 'reading')} of {listed(labels)} (row {at}) "
        f"{'is a spike' if len(rows) == 1 else 'are spikes'}, up to "
        f"{1e6 * float(np.abs(left - between)[spikes].max()):.3g} µm away from the readings before "
        "and after; left out"
    )
    finding = Finding("spikes", "note", tuple(labels), (int(rows.min()), int(rows.max())), text)
    return replace(record, readings=readings, filled=record.filled | spikes), [finding]


def _beside_unread(record: Record) -> Mask:
    """Readings that repeat the one before, and their neighbours: nobody knows how far they are."""
    near = unread(record)
    near[1:] |= near[:-1].copy()
    near[:-1] |= near[1:].copy()
    return near


def _between(left: Matrix, record: Record) -> Matrix:
    """Mean of the readings before and after; those of a single neighbour at the ends."""
    begins = record.starts
    ends = np.append(begins[1:], True)
    before = np.vstack([left[:1], left[:-1]])
    after = np.vstack([left[1:], left[-1:]])
    before = np.where(begins[:, None], after, before)
    after = np.where(ends[:, None], before, after)
    alone = (begins & ends)[:, None]
    return np.where(alone, left, 0.5 * (before + after))


def _spikes(away: Matrix, left: Matrix, record: Record) -> Mask:
    """Find them, shape (N, n)."""
    usual = TO_SIGMA * np.median(np.abs(away), axis=0)
    far = np.abs(away) > FAR * np.maximum(usual, np.finfo(np.float64).tiny)
    far &= usual > 0.0
    far &= _jump(left, record) < ALONE * np.abs(away)
    few = far.sum(axis=1) <= max(1.0, SHARED * far.shape[1])
    far &= few[:, None]
    lone: Mask = far & (far.sum(axis=0) <= most_lone(len(far)))
    return lone


def _jump(left: Matrix, record: Record) -> Matrix:
    """Change between the neighbours of every reading; at an end, between the two next to it.

    So what begins or ends a stretch amid a motion is none; without two neighbours nobody knows.
    """
    begins, rows = record.starts, np.arange(len(left))
    ends = np.append(begins[1:], True)
    length = np.diff(np.append(np.flatnonzero(begins), len(rows)))
    several = np.repeat(length > 2, length)[:, None]
    low = rows + np.where(begins, 1, np.where(ends, -2, -1))
    high = rows + np.where(begins, 2, np.where(ends, -1, 1))
    change = np.take(left, high, axis=0, mode="clip") - np.take(left, low, axis=0, mode="clip")
    return np.where(several, np.abs(change), np.inf)


def most_lone(rows: int) -> float:
    """Number of spikes of a BPM up to which lone ones are likelier than noise with tails.

    Both are Poisson numbers: k ln(TAILS/LONE) < (TAILS − LONE) rows. One is lone in any case.

    Args:
        rows: Of the record.
    """
    return max(1.0, (TAILS - LONE) * rows / math.log(TAILS / LONE))

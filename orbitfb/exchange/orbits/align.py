"""Put PVs that were archived one by one on common ticks, without making anything up.

A tick is where most BPMs have a sample within a tolerance. A BPM that has none there is not valid
at that tick: nothing is taken from its neighbours in time. Setpoints, readbacks and slow channels
are archived when they change, so the last value stands until the next one comes; but not over a
loss of the connection, not beyond a time that may be stated, and not before the first sample.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector
from orbitfb.exchange.formats.archiver import Samples

MOST = 0.5
"""Share of the BPMs that must have a sample for there to be a tick [1]."""

_NANO = 1e9
Stamps = NDArray[np.int64]


def find_ticks(bpms: Sequence[Samples], tolerance: float) -> tuple[Stamps, int]:
    """Find the ticks: stamps around which most BPMs have a sample.

    Args:
        bpms: Samples of the BPMs.
        tolerance: How far after the first stamp of a tick the others may lie [s].

    Returns:
        The first stamp of every tick, shape (T,) [ns], and how many groups of stamps were too
        small to be one.

    Raises:
        ExchangeError: There are none, or the tolerance joins different ticks.
    """
    width = int(tolerance * _NANO)
    stamps = np.sort(np.concatenate([each.stamps for each in bpms])) if bpms else np.empty(0)
    begins: list[int] = []
    counts: list[int] = []
    row = 0
    while row < len(stamps):
        end = int(np.searchsorted(stamps, stamps[row] + width, side="right"))
        begins.append(int(stamps[row]))
        counts.append(end - row)
        row = end
    enough = np.array(counts) >= MOST * len(bpms)
    ticks = np.array(begins, dtype=np.int64)[enough]
    if len(ticks) < 2:
        raise ExchangeError(
            f"{len(ticks)} ticks at which half of the {len(bpms)} BPMs have a sample within "
            f"{tolerance:g} s of each other; give a larger --tolerance if their stamps lie apart"
        )
    period = float(np.median(np.diff(ticks))) / _NANO
    if tolerance >= period / 2:
        raise ExchangeError(
            f"--tolerance {tolerance:g}: ticks are {period:.4g} s apart, so samples of two of them "
            f"could be taken for one; give less than {period / 2:.4g}"
        )
    return ticks, int((~enough).sum())


def at_ticks(samples: Samples, ticks: Stamps, tolerance: float) -> Vector:
    """Give the sample of each tick, NaN where there is none, shape (T,).

    Raises:
        ExchangeError: Two samples belong to one tick.
    """
    width = int(tolerance * _NANO)
    first = np.searchsorted(samples.stamps, ticks, side="left")
    last = np.searchsorted(samples.stamps, ticks + width, side="right")
    twice = np.flatnonzero(last - first > 1)
    if len(twice):
        raise ExchangeError(
            f"{samples.name} has {int((last - first)[twice[0]])} samples within {tolerance:g} s of "
            f"tick {int(twice[0])}; give a smaller --tolerance"
        )
    found = np.full(len(ticks), np.nan)
    there = last > first
    found[there] = samples.values[first[there]]
    return found


def in_force(samples: Samples, ticks: Stamps, hold: float | None) -> Vector:
    """Give the value in force at each tick, NaN where none is known, shape (T,).

    Args:
        samples: Archived when it changes.
        ticks: Shape (T,) [ns].
        hold: Longest time that a value stands without another sample [s]; None: any.
    """
    last = np.searchsorted(samples.stamps, ticks, side="right") - 1
    found = np.full(len(ticks), np.nan)
    there = last >= 0
    found[there] = samples.values[last[there]]
    since = np.where(there, samples.stamps[np.maximum(last, 0)], 0) if len(samples.stamps) else 0
    if hold is not None:
        found[(ticks - since) > hold * _NANO] = np.nan
    if len(samples.lost):
        # The latest loss before the tick: if no sample has come since, nothing is known.
        loss = np.searchsorted(samples.lost, ticks, side="right") - 1
        when = samples.lost[np.maximum(loss, 0)]
        found[(loss >= 0) & (when > since)] = np.nan
    return found

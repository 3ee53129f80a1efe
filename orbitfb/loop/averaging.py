"""Correct less often, and not at all what is small: averages of orbits, and a dead band.

Between two corrections nobody moves a setpoint but the dither, so that the orbits may be averaged:
the noise of n of them is n^½ smaller. The average begins anew after each correction, so that a
correction never acts on an error that was corrected before.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Channels, Vector
from orbitfb.core.values import replace
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.memory import Gathered
from orbitfb.loop.tick import Checked


@dataclass(frozen=True, slots=True)
class Restraint:
    """What the loop acts on.

    Args:
        checked: The orbit error, averaged; 0 in planes that rest.
        gathered: What the next orbit is averaged with.
        share: Of the policy's change that is made, shape (m,): 0 or 1.
        due: Whether enough orbits have come to correct.
    """

    checked: Checked
    gathered: Gathered
    share: Vector
    due: bool


def restrain(
    gathered: Gathered, checked: Checked, wanted: Adjustments, channels: Channels
) -> Restraint:
    """Average an orbit error with those before, and leave planes alone whose error is small.

    Args:
        gathered: Orbit errors since the last correction.
        checked: That of this tick.
        wanted: How many orbits, and which error is small.
        channels: Names the planes.
    """
    whole = np.ones(len(wanted.gain))
    if wanted.average > 1:
        gathered = _gather(gathered, checked)
        if gathered.orbits < wanted.average:
            return Restraint(checked, gathered, np.zeros_like(whole), due=False)
        checked = _mean(gathered, checked)
    if not any(wanted.dead_band):
        return Restraint(checked, Gathered(), whole, due=True)
    error, rows, columns = checked.error.copy(), channels.bpm_parts, channels.corrector_parts
    for plane, band in zip(channels.planes, wanted.dead_band, strict=True):
        seen = error[rows[plane]][checked.valid[rows[plane]]]
        if not seen.size or np.sqrt(np.mean(seen**2)) <= band:
            error[rows[plane]], whole[columns[plane]] = 0.0, 0.0
    return Restraint(replace(checked, error=error), Gathered(), whole, due=True)


def _gather(gathered: Gathered, checked: Checked) -> Gathered:
    counts: NDArray[np.int64] = checked.valid.astype(np.int64)
    total = np.where(checked.valid, checked.error, 0.0)
    if gathered.total is None or gathered.counts is None:
        return Gathered(total, counts, 1)
    return Gathered(gathered.total + total, gathered.counts + counts, gathered.orbits + 1)


def _mean(gathered: Gathered, checked: Checked) -> Checked:
    """Give the mean error of the BPMs that count now; each has been valid at least now."""
    if gathered.total is None or gathered.counts is None:
        return checked
    mean = gathered.total / np.maximum(gathered.counts, 1)
    return replace(checked, error=np.where(checked.valid, mean, 0.0))

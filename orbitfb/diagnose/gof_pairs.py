"""Whether what is left at one BPM goes along with what is left at others."""

import numpy as np
from scipy import stats

from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.diagnose.device_groups import groups_of
from orbitfb.diagnose.naming import column_names
from orbitfb.effects.layout import Devices
from orbitfb.physics.optics import Matrix

NAME = "correlation of BPMs"
_TOLERATED = 0.02
"""Correlation of two BPMs that a drift of another shape than the floor's makes."""
_MOST = 0.25
"""Share of all BPMs from which a group is no few of them."""


def pairs_test(channels: Matrix, devices: Devices, rate: float) -> GoodnessTest:
    """Correlate what is left of every two BPMs, and of those of every cell or rack.

    A crate's common noise is seen in all pairs of its BPMs, in none of them as well as in all.

    Args:
        channels: White innovations by BPM, shape (N, n).
        devices: BPMs of the n columns.
        rate: How often chance alone may flag it.
    """
    rows, count = channels.shape
    power = np.sqrt(np.sum(channels**2, axis=0))
    own = channels / np.where(power > 0.0, power, 1.0)
    among = own.T @ own
    one, other = np.triu_indices(count, 1)
    pairs = among[one, other]
    groups = [its for its in groups_of(devices) if 2 < len(its.members) <= max(_MOST * count, 3)]
    member = np.zeros((len(groups), count))
    for row, its in enumerate(groups):
        member[row, its.members] = 1.0
    sizes = member.sum(axis=1)
    many = sizes * (sizes - 1.0) / 2.0
    within = member * np.diag(among)
    means = (np.sum((member @ among) * member, axis=1) - within.sum(axis=1)) / (2.0 * many)
    means = np.concatenate([pairs, means])
    many = np.concatenate([np.ones(len(pairs)), many])
    values = np.maximum(np.abs(means) - _TOLERATED, 0.0) * np.sqrt(rows * many)
    limit = float(stats.norm.isf(rate / (2 * max(len(values), 1))))
    if not len(values):
        return GoodnessTest(name=NAME, value=0.0, limit=limit, flagged=False, nats=0.0)
    worst = int(np.argmax(values))
    names = column_names(devices)
    if worst < len(pairs):
        where = f"{names[one[worst]]} and {names[other[worst]]}"
    else:
        where = f"the BPMs of {groups[worst - len(pairs)].name}"
    value = float(values[worst])
    return GoodnessTest(
        name=NAME,
        value=value,
        limit=limit,
        flagged=value > limit,
        note=f"standard deviations beyond {_TOLERATED:g}, {where}: {means[worst]:.2f}",
        nats=0.5 * rows * float(many[worst] * means[worst] ** 2),
    )

"""Whether what is left at one BPM goes along with what is left at others."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import GoodnessTest
from orbitfb.diagnose.device_groups import Group, groups_of
from orbitfb.diagnose.result.naming import column_names
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Devices

NAME = "correlation of BPMs"
_TOLERATED = 0.02
"""Correlation of two BPMs that a drift of another shape than the floor's makes."""
_MOST = 0.25
"""Share of all BPMs from which a group is no few of them."""


def pairs_test(channels: Matrix, devices: Devices, rate: float) -> GoodnessTest:
    """Correlate what is left of every two BPMs, and of those of a cell or rack, at once and late.

    A crate's common noise is seen in all pairs of its BPMs, in none of them as well as in all.

    Args:
        channels: White innovations by BPM, shape (N, n).
        devices: BPMs of the n columns.
        rate: How often chance alone may flag it.
    """
    rows, count = channels.shape
    power = np.sqrt(np.sum(channels**2, axis=0))
    own = channels / np.where(power > 0.0, power, 1.0)
    groups = [its for its in groups_of(devices) if 2 < len(its.members) <= max(_MOST * count, 3)]
    member = np.zeros((len(groups), count))
    for row, its in enumerate(groups):
        member[row, its.members] = 1.0
    found = [*_at_once(own, member), *_a_tick_later(own, member)]
    means, many = (np.concatenate(parts) for parts in zip(*found, strict=True))
    values = np.maximum(np.abs(means) - _TOLERATED, 0.0) * np.sqrt(rows * many)
    limit = float(stats.norm.isf(rate / (2 * max(len(values), 1))))
    if not len(values):
        return GoodnessTest(name=NAME, value=0.0, limit=limit, flagged=False, nats=0.0)
    worst = int(np.argmax(values))
    return GoodnessTest(
        name=NAME,
        value=float(values[worst]),
        limit=limit,
        flagged=bool(values[worst] > limit),
        note=f"standard deviations beyond {_TOLERATED:g}, {_where(worst, devices, groups)}: "
        f"{means[worst]:.2f}",
        nats=0.5 * rows * float(many[worst] * means[worst] ** 2),
    )


def _at_once(own: Matrix, member: Matrix) -> list[tuple[Vector, Vector]]:
    """Correlations of pairs, then means of those of groups, each with how many it is of."""
    among = own.T @ own
    pairs = among[np.triu_indices(len(among), 1)]
    return [(pairs, np.ones(len(pairs))), _within(among, member, 0.5)]


def _a_tick_later(own: Matrix, member: Matrix) -> list[tuple[Vector, Vector]]:
    """The same, of what the second one leaves a tick after the first."""
    among = own[:-1].T @ own[1:]
    pairs = among[~np.eye(len(among), dtype=bool)]
    return [(pairs, np.ones(len(pairs))), _within(among, member, 1.0)]


def _within(among: Matrix, member: Matrix, share: float) -> tuple[Vector, Vector]:
    """Mean correlation of all ordered pairs of each group, and the share of these that count."""
    sizes = member.sum(axis=1)
    ordered = sizes * (sizes - 1.0)
    sums = np.sum((member @ among) * member, axis=1) - member @ np.diag(among)
    return sums / ordered, share * ordered


def _where(index: int, devices: Devices, groups: Sequence[Group]) -> str:
    """Put into words what a correlation is of, by its place among all of them."""
    names, count, when = column_names(devices), len(devices), ""
    once = count * (count - 1) // 2 + len(groups)
    one, other = np.triu_indices(count, 1)
    if index >= once:
        index, when = index - once, ", a tick later"
        one, other = np.nonzero(~np.eye(count, dtype=bool))
    if index < len(one):
        return f"{names[one[index]]} and {names[other[index]]}{when}"
    return f"the BPMs of {groups[index - len(one)].name}{when}"

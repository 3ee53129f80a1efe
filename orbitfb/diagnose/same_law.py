"""Entries that are one law here, or laws of the same devices: what one says of the others."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.records.layout import Layout

_SAME = 0.02
"""Two fits leave the same when what they leave differs by less than this share of the gain."""
_ONE_LAW = 9.0
"""Two fits are one law when what they leave differs by less, summed over all squares of the white
innovations, for every parameter that one has more: three standard deviations of what noise does."""
_AT_MOST = 0.2
"""The same as a share of the gain: the changes they make have a cosine of 0.95."""
_UNKNOWN = 10.0
"""Ends of a 90 % interval that are further apart by this factor do not tell a value."""
_NEARLY = 0.8
"""Share of the gain from which another law of the same devices bears witness."""


def devices(cause: Cause, layout: Layout) -> tuple[int, ...]:
    """Places of a cause; all correctors, of what acts on their currents in the whole ring."""
    if isinstance(cause.kind, ActuatorKind) and cause.kind.target == "ring":
        return tuple(range(len(layout.correctors)))
    return cause.places


def alike_alike(entries: Sequence[Entry], layout: Layout) -> list[Entry]:
    """Charge candidates that leave the same the same inflation, and those of the same devices.

    The mean over the values of a fit falls with every value to which the record is blind, so
    that one that is not needed would pay for itself. What the laws of the same devices leave is
    the same surplus; the value of one may move just with it, as a delay does with its jitter.
    """
    judged: list[Entry] = []
    for entry in entries:
        own = entry.fit
        if own is None:
            judged.append(entry)
            continue
        least = own.inflation
        here = devices(entry.cause, layout)
        for other in entries:
            if other.fit is not None and (
                _apart(other.fit, own) < _SAME * own.gain
                or (other.fit.gain > _NEARLY * own.gain and devices(other.cause, layout) == here)
            ):
                least = min(least, other.fit.inflation)
        weight = entry.weight + own.gain * (1.0 / least - 1.0 / own.inflation)
        judged.append(replace(entry, fit=replace(own, inflation=least), weight=weight))
    return judged


def says_little(entry: Entry) -> bool:
    """Whether a value that is fitted by its logarithm is known to no factor.

    A corrector with a time constant far beyond the record is stuck.
    """
    if entry.fit is None:
        return False
    ends = [
        entry.fit.interval(index)
        for index, (_, parameter) in enumerate(entry.fit.parameters)
        if parameter.log
    ]
    return any(high > _UNKNOWN * low for low, high in ends)


def limits(entries: Sequence[Entry]) -> list[Entry]:
    """Mark what is the same law as an effect with fewer parameters, in a limit of its own.

    Within a play that is wider than all it did, a corrector has a gain error. The simpler law is
    the answer; the record does not have to decide between the two.
    """
    marked: list[Entry] = []
    for entry in entries:
        simpler = [
            other
            for other in entries
            if _apart(entry.fit, other.fit)
            < min(_ONE_LAW * max(entry.size - other.size, 0), _AT_MOST * other.gain)
        ]
        law = min(simpler, key=lambda other: other.size, default=None)
        if law is not None:
            worth = min(entry.weight, law.weight)
            entry = replace(entry, limit_of=law.kind.id, weight=worth)
        marked.append(entry)
    return marked


def _apart(one: Fit | None, other: Fit | None) -> float:
    """Sum of the squared differences of what two fits leave; infinite where none can be said."""
    if one is None or other is None or one.white.shape != other.white.shape:
        return np.inf
    return float(np.sum((one.white - other.white) ** 2))

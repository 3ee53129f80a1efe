"""Whether what strikes single ticks does so by as much, and as often, as its law says.

A lost set of setpoints takes all of a step back, a late sample any part of it: the same orbit, so
that each passes for the other where it is not known itself. Spikes are those of a BPM by itself.
What strikes may begin in mid-record, by any of the laws: that is no departure either.
"""

from collections.abc import Callable, Iterator

import numpy as np
from scipy.special import log_ndtr

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.strike_scan import normal_ratio, strikes
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.physics.optics import Matrix

_CHANCES = np.geomspace(0.0005, 0.5, 13)
"""Chances of a strike that are tried."""
_NOW_AND_THEN = 0.1
"""The most of them for another law: what comes every other tick is a delay."""
_SIZES = np.geomspace(0.02, 50.0, 25)
"""Strengths that are tried, in units of one that is just seen."""
_AROUND = np.geomspace(0.5, 2.0, 5)
"""Strengths that are tried of what is known already, over the fitted one."""
_LOUD = 10.0
"""Gain of a strike that is heard in the rows beside it too [nats]."""
_OCCAM = 2.0
"""What every value that a law has more than the cause's costs [nats]."""


def latent_laws(bench: Bench, cause: Cause) -> Iterator[tuple[str, float]]:
    """Try what else could strike as a cause does.

    Args:
        bench: The record under the causes before it.
        cause: What strikes all its devices at once, or BPM by BPM.

    Yields:
        A course in words, and what it gains over the law, less the price of the choice [nats].
    """
    kind = cause.kind
    if not isinstance(kind, LatentKind):
        return
    if kind.per_bpm:
        yield from _in_the_same_rows(bench, kind, cause)
        return
    score, info = (its[:, 0] for its in strikes(bench, kind, cause.places))
    height = 0.5 * score**2 / np.where(info > 0.0, info, np.inf)
    beside = np.maximum(np.append(height[1:], 0.0), np.append(0.0, height[:-1]))
    counted = (info > 0.0) & ((beside < _LOUD) | (height > beside))
    score, info = score[counted], info[counted]
    if not len(info):
        return

    def alike(size: float) -> Vector:
        return size * score - 0.5 * size**2 * info

    def normal(size: float) -> Vector:
        return normal_ratio(score, info, size**2)

    def one_sided(size: float) -> Vector:
        """Normal where it is of one sign, else nothing: at late times the orbit may be still."""
        known = size * score / np.sqrt(1.0 + size**2 * info)
        both = normal(size) + np.log(2.0)
        halves = [np.logaddexp(0.0, both + log_ndtr(side * known)) for side in (-1.0, 1.0)]
        return max((half - np.log(2.0) for half in halves), key=_begun)

    few = _CHANCES[_CHANCES < _NOW_AND_THEN]
    sizes = _SIZES / np.sqrt(np.median(info))
    laws = {
        "always one": ("all of it, now and then", 1, _rarely(alike, np.ones(1), _CHANCES)),
        "normal": (
            "at every tick by another amount",
            1,
            max(_begun(normal(size)) for size in sizes),
        ),
        "sometimes normal": ("now and then by another amount", 2, _rarely(normal, sizes, few)),
        "always alike": (
            "now and then by the same amount",
            2,
            _rarely(alike, np.concatenate([-sizes, sizes]), few),
        ),
    }
    _, values, own = laws.pop(kind.strength)
    if kind.strength == "normal":
        own = max(own, *(_begun(one_sided(size)) for size in sizes))
    for words, its, height in laws.values():
        yield words, height - own - _OCCAM * max(its - values, 0) - float(np.log(len(laws)))


def _in_the_same_rows(bench: Bench, kind: LatentKind, cause: Cause) -> Iterator[tuple[str, float]]:
    """Ask whether several BPMs are struck in the same rows, which spikes of each are not.

    Both laws have the same two values.
    """
    if len(cause.places) < 2 or kind.strength != "sometimes normal":
        return
    score, info = (its[cause.onset :, list(cause.places)] for its in strikes(bench, kind))
    size = cause.values[kind.parameters[-1].name]

    def apart(its: float) -> Matrix:
        return normal_ratio(score, info, its**2)

    def at_once(its: float) -> Vector:
        return np.sum(normal_ratio(score, info, its**2), axis=1)

    few, sizes = _CHANCES[_CHANCES < _NOW_AND_THEN], size * _AROUND
    own = max(_mixed(apart(one), chance) for one in sizes for chance in _CHANCES)
    other = max(_mixed(at_once(one), chance) for one in sizes for chance in few)
    yield "in the same rows at all of them", other - own - _OCCAM


def _mixed(ratios: Matrix | Vector, chance: float) -> float:
    """Gain of strikes that come with a chance, each for itself [nats]."""
    return float(np.sum(np.logaddexp(np.log1p(-chance), np.log(chance) + ratios)))


def _rarely(struck: Callable[[float], Vector], sizes: Vector, chances: Vector) -> float:
    """Best gain of strikes of one of some sizes that come with one of the chances [nats]."""
    gains = [
        _begun(np.logaddexp(np.log1p(-chance), np.log(chance) + ratio))
        for ratio in map(struck, sizes)
        for chance in chances
    ]
    return max(gains)


def _begun(ratios: Vector) -> float:
    """Sum of the ratios from the row on where it is largest: any law may begin in mid-record."""
    return float(np.max(np.cumsum(ratios[::-1])))

"""Places next to that of the best cause: a scan knows roughly what healthy errors hide of each."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.nearby import neighbours
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind

_FAR = 4
"""Correctors on either side."""
_MOST = 3
"""Of those that promise as much as the best one, so many are fitted."""
_AS_MUCH = 5.0
"""What they may promise less [nats]: evidence 150 to 1."""
_HALF = 0.5


def around(bench: Bench, entries: Sequence[Entry]) -> list[Candidate]:
    """Propose places next to that of the best entry which explain the record about as well.

    Neighbours have nearly the same orbit, and how much of it healthy errors hide is only known
    once these have done their best.

    Args:
        bench: The record under the causes accepted so far.
        entries: That were fitted.
    """
    best = max(entries, key=lambda entry: entry.weight, default=None)
    if best is None or best.weight <= 0.0 or best.fit is None or len(best.cause.places) != 1:
        return []
    known = {entry.cause.places for entry in entries if entry.kind is best.kind}
    near = ((place,) for place in _near(bench, best.kind, best.cause.places[0]))
    near = (places for places in near if places not in known)
    found = [_promise(bench, replace(best.cause, places=places)) for places in near]
    found = [one for one in found if one[0] > best.gain - _AS_MUCH]
    found.sort(key=lambda one: one[0], reverse=True)
    return [
        replace(best.candidate, cause=cause, gain=gain, alone=None) for gain, cause in found[:_MOST]
    ]


def _near(bench: Bench, kind: EffectKind, place: int) -> list[int]:
    """Places with nearly the orbit of one; pairs that share one corrector, the other next to its.

    None of what acts at a BPM: there each is itself.
    """
    layout = bench.record.layout
    if kind.linear is None:
        return []
    if isinstance(kind, SourceKind):
        return [
            other for other in neighbours(bench, kind.patterns(layout), place) if other != place
        ]
    if isinstance(kind, PairKind) and kind.target == "corrector":
        pairs, count = kind.pairs(layout), len(layout.correctors)
        planes = np.unique(layout.correctors.planes, return_inverse=True)[1]
        apart = np.abs((pairs - pairs[place] + count // 2) % count - count // 2)
        near = (apart.min(axis=1) == 0) & (apart.max(axis=1) <= _FAR) & (apart.max(axis=1) > 0)
        return np.flatnonzero(near & np.all(planes[pairs] == planes[pairs[place]], axis=1)).tolist()
    return []


def _promise(bench: Bench, cause: Cause) -> tuple[float, Cause]:
    """Gain of a cause of best size, by two sizes and a parabola, and the cause of that size."""
    kind, name = cause.kind, cause.kind.linear or ""
    parameter = next(one for one in kind.parameters if one.name == name)
    size, base = cause.values[name], bench.log_likelihood

    def at(share: float) -> Cause:
        value = float(np.clip(share * size, parameter.low, parameter.high))
        return replace(cause, values={**cause.values, name: value})

    half, whole = (log_likelihood(*bench.residual((at(s),))) - base for s in (_HALF, 1.0))
    slope = 4.0 * half - whole
    bend = 2.0 * (slope - whole)
    if bend <= 0.0:
        return max(whole, 0.0), cause
    return 0.5 * slope**2 / bend, at(slope / bend)

"""Places next to that of the best cause: a scan knows roughly what each would do.

It takes values from a grid, and does not know what healthy errors hide of every place.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.nearby import neighbours
from orbitfb.effects.device_kinds import ActuatorKind, PairKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix

_FAR = 4
"""Correctors on either side."""
_MOST = 3
"""Of those that promise as much as the best one, so many are fitted."""
_AS_MUCH = 5.0
"""What they may promise less [nats]: evidence 150 to 1."""
_HALF = 0.5
_ALIKE = 0.8
"""Cosine of the orbits of two correctors from which one may be taken for the other."""


def around(bench: Bench, entries: Sequence[Entry]) -> list[Candidate]:
    """Propose places next to that of the best entry which explain the record about as well.

    Neighbours have nearly the same orbit, and how much of it healthy errors hide is only known
    once these have done their best.

    Args:
        bench: The record under the causes accepted so far.
        entries: That were fitted.
    """
    best = max(entries, key=lambda entry: entry.worth, default=None)
    if best is None or best.weight <= 0.0 or best.fit is None or len(best.cause.places) != 1:
        return []
    known = {entry.cause.places for entry in entries if entry.kind is best.kind}
    near = ((place,) for place in _near(bench, best.kind, best.cause.places[0]))
    others = [replace(best.cause, places=places) for places in near if places not in known]
    if best.kind.linear is None:  # what it would gain a fit alone tells
        return [replace(best.candidate, cause=cause, alone=None) for cause in others[:_MOST]]
    found = [_promise(bench, cause) for cause in others]
    found = [one for one in found if one[0] > best.gain - _AS_MUCH]
    found.sort(key=lambda one: one[0], reverse=True)
    return [
        replace(best.candidate, cause=cause, gain=gain, alone=None) for gain, cause in found[:_MOST]
    ]


def _near(bench: Bench, kind: EffectKind, place: int) -> list[int]:
    """Places with nearly the orbit of one, of correctors the likest first.

    Of pairs those that share one corrector, the other next to its. None of what acts at a BPM:
    there each is itself.
    """
    layout = bench.record.layout
    if isinstance(kind, ActuatorKind) and kind.target == "corrector":
        alike = _cosines(layout.response, place)
        order = np.argsort(alike)[::-1].tolist()
        return [other for other in order if other != place and alike[other] > _ALIKE]
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


def _cosines(orbits: Matrix, place: int) -> Vector:
    """How alike the orbit of one corrector and those of all are, whatever their signs, (m,)."""
    sizes = np.linalg.norm(orbits, axis=0)
    return np.abs(orbits.T @ orbits[:, place]) / np.maximum(sizes * sizes[place], 1e-300)


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

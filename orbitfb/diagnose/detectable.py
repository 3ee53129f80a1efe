"""What size of every effect a record would have shown: what stands behind each "not found".

A change δ of the prediction is seen with ½ |δ|² nats, |δ|² = Σ (F δ)² / S less what the healthy
errors of gains and gradients take away; 5σ are 12.5 nats. Where δ is proportional to a parameter
its size follows at once, where it is not the grid of the scan is searched.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_parts import Detectable, NotTested
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.detectable_random import smallest_line, smallest_noise, smallest_strike
from orbitfb.diagnose.detectable_sizes import (
    Seen,
    median,
    size_parameter,
    smallest,
    tried,
    within,
)
from orbitfb.diagnose.ladder import Ladder
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

THERE = "there"
"""In the place of a parameter for an effect that has none: it is either there or not."""
_LEVELS = 4
_SAMPLE = 12
"""Places that stand for all where a grid is searched, from the most to the least seen."""
_PAIRS = 48
_INVISIBLE = 1e-3
"""Gain of a typical size below which a steady effect leaves no trace [nats]."""

Part = tuple[Matrix, Matrix]
"""Patterns (n, P) and drivers (N, P) or (N, 1)."""


def detectable(
    bench: Bench, kinds: Iterable[EffectKind]
) -> tuple[tuple[Detectable, ...], tuple[NotTested, ...]]:
    """Tell what size of every effect the record would have shown at 5σ.

    A size is the distance of the parameter from nothing; where nothing is its largest value (a
    limit, a slew rate) it is the value itself. What leaves no trace unless it begins in the
    middle (an offset, a kick) is taken to begin half-way.

    Args:
        bench: The record under the causes so far; its floor and its healthy errors count.
        kinds: Effects.

    Returns:
        Sizes (None where no size that makes sense would have shown), and the effects that the
        record cannot show at all, with the reasons.
    """
    measure = _Measure(bench)
    sizes: list[Detectable] = []
    untested: list[NotTested] = []
    for kind in kinds:
        reason = kind.unavailable(bench.record)
        if reason:
            untested.append(NotTested(effect=kind.id, reason=reason))
        else:
            sizes.append(measure.size(kind))
    return tuple(sizes), tuple(untested)


class _Measure:
    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._ladder = Ladder(bench.floor, _LEVELS)
        self._starts = bench.record.starts
        self._late = np.zeros(len(bench.record), dtype=np.bool_)
        self._late[len(bench.record) // 2 :] = True
        self._shares: dict[tuple[str, bool], float] = {}
        layout = bench.record.layout
        self._patterns = {"correctors": layout.response, "bpms": np.eye(len(layout.bpms))}
        self._moved = {"correctors": bench.currents, "bpms": bench.orbit}
        self._shapes = {key: self._ladder.shapes(its) for key, its in self._patterns.items()}
        self._courses = {
            key: self._ladder.filtered(its, self._starts) for key, its in self._moved.items()
        }
        self._gains = {
            key: _quadratic(self._shapes[key], self._courses[key], self._courses[key])
            for key in self._moved
        }

    def size(self, kind: EffectKind) -> Detectable:
        record = self._bench.record
        if isinstance(kind, NoiseKind):
            middle, best = within(kind, record, smallest_noise(self._bench, kind))
        elif isinstance(kind, LatentKind):
            middle, best = within(kind, record, np.array([smallest_strike(self._bench, kind)]))
        elif getattr(kind, "periodic", False) and isinstance(kind, SourceKind):
            middle, best = within(kind, record, smallest_line(self._bench, kind))
        else:
            seen = [self._seen(kind, values) for values in tried(kind, self._bench)]
            if kind.sudden and max(float(np.max(s.gain, initial=0.0)) for s in seen) < _INVISIBLE:
                seen = [self._seen(kind, values, late=True) for values in tried(kind, self._bench)]
            middle = smallest(kind, record, seen, [median(s.gain) for s in seen])
            best = smallest(kind, record, seen, [float(np.max(s.gain, initial=0.0)) for s in seen])
        spec = size_parameter(kind, record)
        return Detectable(
            effect=kind.id,
            parameter=spec.name if spec else THERE,
            size=middle,
            unit=spec.unit if spec else "1",
            best=best,
        )

    def _seen(self, kind: EffectKind, values: Values, late: bool = False) -> Seen:
        bench, record = self._bench, self._bench.record
        if isinstance(kind, PairKind):
            info = self._of_pairs(kind, values)
        elif kind.target == "ring" and isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, record) - bench.currents
            info = self._whole(kind, moved @ record.layout.response.T, late)
        elif isinstance(kind, RingKind):
            change = kind.deflect(values, record, bench.currents, bench.orbit)
            info = self._whole(kind, change, late)
        elif isinstance(kind, SourceKind):
            info = self._of_source(kind, values, late)
        elif isinstance(kind, ActuatorKind | SensorKind):
            info = self._of_devices(kind, values, late)
        else:
            info = np.zeros(1)
        return Seen(values, 0.5 * info)

    def _of_devices(self, kind: ActuatorKind | SensorKind, values: Values, late: bool) -> Vector:
        """Of single devices; what looks like a healthy gain error is taken for one."""
        which = "correctors" if isinstance(kind, ActuatorKind) else "bpms"
        columns = self._sample(which, everywhere=kind.linear is not None)
        before = self._moved[which][:, columns]
        act = kind.drive if isinstance(kind, ActuatorKind) else kind.distort
        moved = act(before, values, self._bench.record) - before
        if late:
            moved *= self._late[:, None]
        shapes = [shape[:, columns] for shape in self._shapes[which]]
        own = [course[:, columns] for course in self._courses[which]]
        courses = self._ladder.filtered(moved, self._starts)
        total = _quadratic(shapes, courses, courses)
        alike = _quadratic(shapes, courses, own) ** 2
        alike /= np.maximum(total * self._gains[which][columns], 1e-300)
        absorbed = self._bench.background.absorbed(which)[columns]
        return total * (1.0 - np.clip(alike, 0.0, 1.0) * absorbed)

    def _sample(self, which: str, everywhere: bool) -> Indices:
        order = np.argsort(self._gains[which])
        if everywhere or len(order) <= _SAMPLE:
            return order
        return order[np.linspace(0, len(order) - 1, _SAMPLE).astype(np.intp)]

    def _of_source(self, kind: SourceKind, values: Values, late: bool) -> Vector:
        bench, layout = self._bench, self._bench.record.layout
        patterns = kind.patterns(layout)
        drivers = kind.drivers(values, bench.record, bench.currents, bench.orbit)
        if late:
            drivers = drivers * self._late[:, None]
        parts: list[Part] = [(patterns, drivers)]
        if drivers.ndim == 3:
            parts = []
            for plane, driver in zip(("x", "y"), drivers, strict=True):
                rows = layout.bpms.in_plane(plane)
                if len(rows):
                    own = np.zeros_like(patterns)
                    own[rows] = patterns[rows]
                    parts.append((own, driver))
        raw = np.zeros(patterns.shape[1])
        for shape, driver in parts:
            courses = self._ladder.filtered(driver, self._starts)
            raw += _quadratic(self._ladder.shapes(shape), courses, courses)
        if kind.linear is None or not np.any(raw > 0):
            return raw
        return raw * self._left(raw, parts)

    def _left(self, raw: Vector, parts: Sequence[Part]) -> float:
        """Share of the information on a source that healthy errors leave, at the median place."""
        place = int(np.argsort(raw)[len(raw) // 2])
        change = np.zeros_like(self._bench.orbit)
        for patterns, drivers in parts:
            course = drivers[:, place if drivers.shape[1] > 1 else 0]
            change += np.outer(course, patterns[:, place])
        whole = float(np.sum(self._bench.floor.whiten(change, self._starts) ** 2))
        return self._bench.information(change) / whole if whole > 0.0 else 1.0

    def _whole(self, kind: EffectKind, change: Matrix, late: bool) -> Vector:
        """Of an effect on the whole ring; what healthy errors leave of it is computed once."""
        change = change * self._late[:, None] if late else change
        raw = float(np.sum(self._bench.floor.whiten(change, self._starts) ** 2))
        key = (kind.id, late)
        if key not in self._shares and raw > 0.0:
            self._shares[key] = self._bench.information(change) / raw
        return np.array([raw * self._shares.get(key, 1.0)])

    def _of_pairs(self, kind: PairKind, values: Values) -> Vector:
        layout = self._bench.record.layout
        pairs = kind.pairs(layout)
        if not len(pairs):
            return np.zeros(0)
        chosen = np.unique(np.linspace(0, len(pairs) - 1, _PAIRS).astype(np.intp))
        change = kind.matrices(layout, values)[chosen] - np.eye(2)
        which = "correctors" if kind.target == "corrector" else "bpms"
        info = np.zeros(len(chosen))
        for shape, course in zip(self._shapes[which], self._courses[which], strict=True):
            for row, (pair, matrix) in enumerate(zip(pairs[chosen], change, strict=True)):
                own, moved = shape[:, pair] @ matrix, course[:, pair]
                info[row] += float(np.sum((own.T @ own) * (moved.T @ moved)))
        return info


def _quadratic(
    shapes: Sequence[Matrix], courses: Sequence[Matrix], others: Sequence[Matrix]
) -> Vector:
    """Σ over levels of |shape|² (course · other), place by place."""
    pieces = [
        np.sum(shape**2, axis=0) * np.einsum("kp,kp->p", course, other)
        for shape, course, other in zip(shapes, courses, others, strict=True)
    ]
    return np.sum(pieces, axis=0)

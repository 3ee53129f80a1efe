"""What a change at any place of a bench would score, and how well it would be seen.

A change of the prediction is a pattern times a driver, so that the score of all places is one
product with λ and the information on them a sum over a few ladder filters. Patterns that depend on
the bench alone are prepared once.
"""

from collections.abc import Callable, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Healthy
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import restored
from orbitfb.diagnose.ladder import Ladder, row_steps
from orbitfb.diagnose.quick import Single
from orbitfb.diagnose.scan_changes import Changes, Shapes
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import ChannelPlane, Layout

_PLANES: tuple[ChannelPlane, ...] = ("x", "y")
_ROUGH = 4
"""Levels of the ladder for the first look at a whole grid of values."""


class Scoring:
    """Scores changes of the prediction on one bench.

    Args:
        bench: The record under the causes so far.

    Attributes:
        ladder: Of filters that whiten patterns and drivers apart.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self.ladder = Ladder(bench.floor, between=True)
        self._rough = Ladder(bench.floor, _ROUGH, between=True)
        self._starts = bench.record.starts
        self._known: dict[str, Shapes] = {}
        self._courses: dict[Healthy, list[Matrix]] = {}
        self._moves: dict[Healthy, Single] = {}

    def courses(self, drivers: Matrix) -> list[Matrix]:
        """Filter drivers (N, P) as every level of the ladder does."""
        return self.ladder.filtered(drivers, self._starts)

    def begun(self, level: int, drivers: Matrix, first: Matrix) -> tuple[Matrix, Matrix]:
        """Energy of drivers (N, P) that begin in a row with a first step: see `Ladder.begun`."""
        return self.ladder.begun(level, drivers, first, self._starts)

    def correctors(self) -> Shapes:
        """Give the orbit that every corrector makes."""
        return self._shapes("correctors", lambda: self._bench.record.layout.response)

    def changes(self, kind: EffectKind, values: Values) -> Changes:
        """Tell how the prediction changes by every place at once."""
        bench, record = self._bench, self._bench.record
        if isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, record) - bench.currents
            return Changes(((self.correctors(), moved),), (("correctors", _own(moved)),), self)
        if isinstance(kind, SensorKind):
            moved = self._restored(kind, values)
            if moved is None:
                moved = kind.distort(bench.orbit, values, record) - bench.orbit
            shapes = self._shapes("bpms", lambda: np.eye(moved.shape[1]))
            return Changes(((shapes, moved),), (("bpms", _own(moved)),), self)
        if isinstance(kind, SourceKind):
            patterns = kind.patterns(record.layout)
            drivers = kind.drivers(values, record, bench.currents, bench.orbit)
            if drivers.ndim == 2:
                shapes = self._shapes(kind.id, lambda: patterns)
                return Changes(((shapes, drivers),), (None,), self)
            parts: list[tuple[Shapes, Matrix]] = []
            alike: list[tuple[Healthy, Indices] | None] = []
            beside = _quadrupoles_of(kind, record.layout)
            for plane, driver in zip(_PLANES, drivers, strict=True):
                rows = record.layout.bpms.in_plane(plane)
                if len(rows):
                    own = np.zeros_like(patterns)
                    own[rows] = patterns[rows]
                    shapes = self._shapes(f"{kind.id} {plane}", lambda own=own: own)
                    parts.append((shapes, driver))
                    alike.append(None if beside is None else (plane, beside))
            return Changes(tuple(parts), tuple(alike), self)
        raise TypeError(f"{kind.id} has no places to scan")

    def _restored(self, kind: SensorKind, values: Values) -> Matrix | None:
        """Change by what is read as it should have been, all BPMs at once, shape (N, n).

        What is not small has taken the predicted orbit with it; the readings themselves tell what
        undoing an effect gains, to second order exactly. None for one that can be small, or that
        scales or filters the noise of the readings.
        """
        if kind.linear is not None:
            return None
        readings = restored(self._bench.record, self._bench.causes)[0]
        undone, jacobian = kind.restore(readings, values, self._bench.record)
        if np.any(jacobian):
            return None
        moved = readings - undone
        return moved + kind.heard(self._bench.orbit, values, self._bench.record)

    def _shapes(self, name: str, patterns: Callable[[], Matrix]) -> Shapes:
        """Patterns by name, prepared once."""
        if name not in self._known:
            own = patterns()
            rough = self._rough.shapes(own)
            # the filter of a level passes (1 + feedback)⁻² of the square of any step at least
            pairs = zip(rough, self._rough.feedback, strict=True)
            least = np.sum([s.T @ s / (1.0 + feedback) ** 2 for s, feedback in pairs], axis=0)
            self._known[name] = Shapes(
                own, self._bench.slope @ own, self.ladder.shapes(own), rough, least
            )
        return self._known[name]

    def steps(self, courses: Matrix) -> Single:
        """Change of courses (N, P) from row to row; none where a stretch begins."""
        return row_steps(courses, self._starts)

    def copied(self, steps: Single, its: tuple[Healthy, Indices] | None) -> Vector:
        """Share of steps (N, P) that healthy errors may make as well, at most, shape (P,)."""
        if its is None:
            return np.zeros(steps.shape[1])
        name, which = its
        if name not in self._moves:
            self._moves[name] = self.steps(self._moved_by(name))
        like = self._moves[name][:, which]
        both = np.einsum("kp,kp->p", steps, like)
        own = np.einsum("kp,kp->p", like, like) * np.einsum("kp,kp->p", steps, steps)
        share = np.divide(both**2, own, out=np.zeros_like(own), where=own > 0.0)
        return np.clip(share, 0.0, 1.0) * self._bench.background.absorbed(name)[which]

    def information(self, changes: Changes, places: Indices) -> tuple[Vector, Vector]:
        """Information on some places, and the share of it that the background takes away."""
        total = np.zeros(len(places))
        taken = np.zeros(len(places))
        for (shapes, drivers), its in zip(changes.parts, changes.alike, strict=True):
            sizes = [np.sum(shape[:, places] ** 2, axis=0) for shape in shapes.rough]
            shared = drivers.shape[1] == 1
            courses = self._rough.filtered(drivers if shared else drivers[:, places], self._starts)
            known = _products(sizes, courses, courses)
            total = total + known
            if its is not None:
                name, which = its[0], its[1][places]
                like = [course[:, which] for course in self._healthy(name)]
                both, own = _products(sizes, courses, like), _products(sizes, like, like)
                share = np.clip(both**2 / np.maximum(known * own, 1e-300), 0.0, 1.0)
                taken = taken + known * share * self._bench.background.absorbed(name)[which]
        return total, taken / np.maximum(total, 1e-300)

    def together(self, changes: Changes, groups: Sequence[Indices]) -> Vector:
        """Information on groups of which all places are struck alike, beyond healthy errors.

        Neighbours that steer against each other are seen much less than each by itself.

        Args:
            changes: Of a kind whose patterns have one part.
            groups: Places of each.

        Returns:
            Shape (groups,).
        """
        if not groups:
            return np.zeros(0)
        places = np.unique(np.concatenate(groups))
        (shapes, drivers), *_ = changes.parts
        keep = np.sqrt(1.0 - self.information(changes, places)[1])
        courses = self._rough.filtered(drivers[:, places] * keep, self._starts)
        known = np.zeros(len(groups))
        for shape, course in zip(shapes.rough, courses, strict=True):
            for index, own in enumerate(groups):
                one, other = shape[:, own], course[:, np.searchsorted(places, own)]
                known[index] += float(np.vdot(one.T @ one, other.T @ other))
        return known

    def _healthy(self, name: Healthy) -> list[Matrix]:
        """Courses of the small errors of all places, filtered as the rough ladder does."""
        if name not in self._courses:
            self._courses[name] = self._rough.filtered(self._moved_by(name), self._starts)
        return self._courses[name]

    def _moved_by(self, name: Healthy) -> Matrix:
        """Courses of the small errors of all places, shape (N, P)."""
        bench, layout = self._bench, self._bench.record.layout
        if name == "correctors":
            return bench.currents
        if name == "bpms":
            return bench.orbit
        return bench.currents @ layout.orbit_at("QUAD", name).T

    def whole(self, change: Matrix) -> Vector:
        """Give the score, shape (1,), of one change of all readings (N, n)."""
        return np.atleast_1d(np.sum(self._bench.slope * change))

    def seen(self, change: Matrix) -> float:
        """Tell the information on one change of all readings (N, n) [nats]."""
        return self._bench.energy(change)


def _own(drivers: Matrix) -> Indices:
    return np.arange(drivers.shape[1])


def _quadrupoles_of(kind: EffectKind, layout: Layout) -> Indices | None:
    """Quadrupole whose gradient error acts most like an effect at each place; None: none does."""
    if kind.target not in ("quadrupole", "sextupole"):
        return None
    ring = layout.known_ring
    quadrupoles = ring.places("QUAD")
    if kind.target == "quadrupole":
        return np.arange(len(quadrupoles))
    apart = np.abs(np.subtract.outer(ring.table.s[ring.places("SEXT")], ring.table.s[quadrupoles]))
    return np.argmin(apart, axis=1)


def _products(
    sizes: Sequence[Vector], courses: Sequence[Matrix], others: Sequence[Matrix]
) -> Vector:
    """Σ over levels of size · (course · other), place by place."""
    pieces = [
        size * np.einsum("kp,kp->p", course, other)
        for size, course, other in zip(sizes, courses, others, strict=True)
    ]
    return np.sum(pieces, axis=0)

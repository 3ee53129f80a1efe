"""What a change at any place of a bench would score, and how well it would be seen.

A change of the prediction is a pattern times a driver, so that the score of all places is one
product with λ and the information on them a sum over a few ladder filters. Patterns that depend on
the bench alone are prepared once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Healthy
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.innovation import Ladder
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.layout import ChannelPlane, Layout
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_PLANES: tuple[ChannelPlane, ...] = ("x", "y")
_ROUGH = 4
"""Levels of the ladder for the first look at a whole grid of values."""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Patterns of P places, and what depends on nothing else.

    Args:
        patterns: Shape (n, P).
        pull: λ · pattern of every row, shape (N, P).
        fine: In the levels of the ladder.
        rough: In the levels of the rough ladder.
    """

    patterns: Matrix
    pull: Matrix
    fine: list[Matrix]
    rough: list[Matrix]


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes of the prediction by P places: Σ over parts of pattern · driver.

    Args:
        parts: Pairs of shapes and drivers (N, P) or (N, 1).
        alike: Healthy errors that may act like them, part by part: what has them, and which one
            belongs to which place; None where there are none.
        measure: Tells the information on them for a scoring.
    """

    parts: tuple[tuple[Shapes, Matrix], ...]
    alike: tuple[tuple[Healthy, Indices] | None, ...]
    measure: "Callable[[Changes], tuple[Vector, Vector]]"

    @cached_property
    def score(self) -> Vector:
        """Score of every place, shape (P,)."""
        total: Vector = np.zeros(1)
        for shapes, drivers in self.parts:
            if drivers.shape[1] == 1:
                total = total + drivers[:, 0] @ shapes.pull
            else:
                total = total + np.einsum("kp,kp->p", shapes.pull, drivers)
        return total

    @cached_property
    def information(self) -> tuple[Vector, Vector]:
        """Information on every place, and the share of it that the background takes away."""
        return self.measure(self)


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

    def courses(self, drivers: Matrix) -> list[Matrix]:
        """Filter drivers (N, P) as every level of the ladder does."""
        return self.ladder.filtered(drivers, self._starts)

    def correctors(self) -> Shapes:
        """Give the orbit that every corrector makes."""
        return self._shapes("correctors", lambda: self._bench.record.layout.response)

    def changes(self, kind: EffectKind, values: Values) -> Changes:
        """Tell how the prediction changes by every place at once."""
        bench, record = self._bench, self._bench.record
        measure = self._information
        if isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, record) - bench.currents
            return Changes(((self.correctors(), moved),), (("correctors", _own(moved)),), measure)
        if isinstance(kind, SensorKind):
            # What is not small has taken the predicted orbit with it: take the model's own.
            small = bool(kind.parameters)
            orbit = bench.orbit if small else bench.currents @ record.layout.response.T
            moved = kind.distort(orbit, values, record) - orbit
            shapes = self._shapes("bpms", lambda: np.eye(moved.shape[1]))
            return Changes(((shapes, moved),), (("bpms", _own(moved)),), measure)
        if isinstance(kind, SourceKind):
            patterns = kind.patterns(record.layout)
            drivers = kind.drivers(values, record, bench.currents, bench.orbit)
            if drivers.ndim == 2:
                shapes = self._shapes(kind.id, lambda: patterns)
                return Changes(((shapes, drivers),), (None,), measure)
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
            return Changes(tuple(parts), tuple(alike), measure)
        raise TypeError(f"{kind.id} has no places to scan")

    def _shapes(self, name: str, patterns: Callable[[], Matrix]) -> Shapes:
        """Patterns by name, prepared once."""
        if name not in self._known:
            own = patterns()
            self._known[name] = Shapes(
                own, self._bench.slope @ own, self.ladder.shapes(own), self._rough.shapes(own)
            )
        return self._known[name]

    def _information(self, changes: Changes) -> tuple[Vector, Vector]:
        """Information on every place, and the share of it that the background takes away."""
        total: Vector = np.zeros(1)
        taken: Vector = np.zeros(1)
        for (shapes, drivers), its in zip(changes.parts, changes.alike, strict=True):
            sizes = [np.sum(shape**2, axis=0) for shape in shapes.rough]
            courses = self._rough.filtered(drivers, self._starts)
            known = _products(sizes, courses, courses)
            total = total + known
            if its is not None:
                name, which = its
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
        (shapes, drivers), *_ = changes.parts
        keep = np.sqrt(1.0 - changes.information[1])
        courses = self._rough.filtered(drivers * keep, self._starts)
        known = np.zeros(len(groups))
        for shape, course in zip(shapes.rough, courses, strict=True):
            for index, own in enumerate(groups):
                one, other = shape[:, own], course[:, own]
                known[index] += float(np.vdot(one.T @ one, other.T @ other))
        return known

    def _healthy(self, name: Healthy) -> list[Matrix]:
        """Courses of the small errors of all places, filtered as the rough ladder does."""
        if name not in self._courses:
            bench, layout = self._bench, self._bench.record.layout
            if name == "correctors":
                course = bench.currents
            elif name == "bpms":
                course = bench.orbit
            else:
                course = bench.currents @ layout.orbit_at("QUAD", name).T
            self._courses[name] = self._rough.filtered(course, self._starts)
        return self._courses[name]

    def whole(self, change: Matrix) -> tuple[Vector, Vector]:
        """Give score and information, shape (1,), of one change of all readings (N, n)."""
        score = np.sum(self._bench.slope * change)
        return np.asarray(score)[None], np.asarray(self.seen(change))[None]

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

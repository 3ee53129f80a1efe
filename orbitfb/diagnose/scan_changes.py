"""Changes of the prediction that an effect makes at every place, and what they are made of."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import Healthy
from orbitfb.diagnose.quick import Single
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

if TYPE_CHECKING:
    from orbitfb.diagnose.scan_shapes import Scoring


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Patterns of P places, and what depends on nothing else.

    Args:
        patterns: Shape (n, P).
        pull: λ · pattern of every row, shape (N, P).
        fine: In the levels of the ladder.
        rough: In the levels of the rough ladder.
        least: Information on two changes at one tick, at least, per product of their steps, (P, P).
    """

    patterns: Matrix
    pull: Matrix
    fine: list[Matrix]
    rough: list[Matrix]
    least: Matrix


@dataclass(frozen=True, eq=False)
class Changes:
    """Changes of the prediction by P places: Σ over parts of pattern · driver.

    Args:
        parts: Pairs of shapes and drivers (N, P) or (N, 1).
        alike: Healthy errors that may act like them, part by part: what has them, and which one
            belongs to which place; None where there are none.
        scoring: That tells the information on them.
    """

    parts: tuple[tuple[Shapes, Matrix], ...]
    alike: tuple[tuple[Healthy, Indices] | None, ...]
    scoring: "Scoring"

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
        return self.scoring.information(self, np.arange(len(self.score)))

    @cached_property
    def steps(self) -> list[Single]:
        """Change of every part's drivers from row to row."""
        return [self.scoring.steps(drivers) for _, drivers in self.parts]

    @cached_property
    def kept(self) -> list[Vector]:
        """Share of the steps of every part, at least, that healthy errors cannot make."""
        return [
            1.0 - self.scoring.copied(steps, its)
            for steps, its in zip(self.steps, self.alike, strict=True)
        ]

    @cached_property
    def least(self) -> Vector:
        """Information on every place beyond healthy errors, at least, shape (P,)."""
        total: Vector = np.zeros(1)
        for (shapes, _), steps, kept in zip(self.parts, self.steps, self.kept, strict=True):
            energy = np.einsum("kp,kp->p", steps, steps)
            total = total + np.diagonal(shapes.least) * energy * kept
        return total

    @cached_property
    def both_least(self) -> Matrix:
        """The same of every two places that are struck alike, of one part, shape (P, P)."""
        ((shapes, _), *_), (steps, *_), (kept, *_) = self.parts, self.steps, self.kept
        weight = np.sqrt(kept)
        return (steps.T @ steps) * shapes.least * np.outer(weight, weight)

    def least_together(self, groups: Sequence[Indices]) -> Vector:
        """The same of groups of places that are struck alike, of one part, shape (groups,)."""
        return np.array([self.both_least[np.ix_(own, own)].sum() for own in groups])

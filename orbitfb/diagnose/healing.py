"""The small errors of a healthy ring as one linear problem, in its uncoupled parts."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.quick import Single
from orbitfb.diagnose.uncoupled import compact, components
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


class Errors:
    """P small errors: orbit = Σ size · pattern · driver, drivers that are mixed of few courses.

    Args:
        patterns: Shape (n, P).
        courses: Shape (N, C).
        weights: That make drivers of courses, times the scatter of each, shape (C, P).

    Attributes:
        patterns: As given.
        drivers: Times the scatter of each, shape (N, P).
        bpms: n.
        count: P.
    """

    def __init__(self, patterns: Matrix, courses: Matrix, weights: Matrix) -> None:
        self.patterns, self.drivers = patterns, (courses @ weights).astype(np.float32)
        self.bpms, self.count = patterns.shape
        single = np.count_nonzero(patterns, axis=0) == 1
        # An error of one BPM needs no product: its reading is its pattern.
        self._alone = np.flatnonzero(single)
        self._where = np.argmax(patterns[:, self._alone] != 0.0, axis=0)
        self._size = patterns[self._where, self._alone].astype(np.float32)
        if len(np.unique(self._where)) != len(self._where):
            self._alone, self._where = np.zeros(0, np.intp), np.zeros(0, np.intp)
            self._size = np.zeros(0, np.float32)
        wide = np.setdiff1d(np.arange(self.count), self._alone)
        self._parts = [
            _Part.of(own, wide[its], patterns, courses, weights)
            for own, its in components(patterns[:, wide])
        ]
        self._own = np.ascontiguousarray(self.drivers[:, self._alone] * self._size)

    def score(self, slope: Single) -> Vector:
        """Derivative by every size of a sum that goes with λ, shape (P,) of (N, n)."""
        found = np.zeros(self.count)
        found[self._alone] = np.einsum("kp,kp->p", slope[:, compact(self._where)], self._own)
        for part in self._parts:
            moments = slope[:, part.rows].T @ part.courses
            found[part.columns] = np.einsum("ip,ip->p", part.patterns, moments @ part.weights)
        return found

    def orbit(self, sizes: Vector) -> Single:
        """What errors of these sizes add to the orbit, shape (N, n)."""
        orbit = np.zeros((len(self.drivers), self.bpms), dtype=np.float32)
        for part in self._parts:
            response = (part.patterns * sizes[part.columns]) @ part.weights.T
            orbit[:, part.rows] = part.courses @ response.T.astype(np.float32)
        orbit[:, compact(self._where)] += self._own * sizes[self._alone].astype(np.float32)
        return orbit


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Errors that act on the same BPMs.

    Args:
        rows: The BPMs.
        columns: The errors, (p,).
        patterns: Shape (i, p).
        courses: That drive them, shape (N, c).
        weights: Shape (c, p).
    """

    rows: Indices | slice
    columns: Indices
    patterns: Matrix
    courses: Single
    weights: Matrix

    @classmethod
    def of(
        cls, own: Indices, its: Indices, patterns: Matrix, courses: Matrix, weights: Matrix
    ) -> "_Part":
        used = np.flatnonzero(weights[:, its].any(axis=1))
        mixed = courses[:, used].astype(np.float32)
        return cls(compact(own), its, patterns[np.ix_(own, its)], mixed, weights[np.ix_(used, its)])


class Preconditioner:
    """Nearly the inverse of the information on all sizes and their prior.

    Args:
        errors: Whose sizes are open.
        floor: The noise.
        starts: Where stretches begin, shape (N,).
        levels: Of the ladder of filters.
        held: Sums of errors that are known to be nothing within ±1, each of shape (P,).

    Attributes:
        absorbed: Share of the information on every error that all of them take away, shape (P,).
        log_volume: ½ log |Q| / |J + Q| of the information J and the prior's Q [nats].
    """

    def __init__(
        self,
        errors: Errors,
        floor: NoiseFloor,
        starts: Mask,
        levels: int,
        held: Sequence[Vector] = (),
    ) -> None:
        ladder = Ladder(floor, levels)
        shapes = [shape.astype(np.float32) for shape in ladder.shapes(errors.patterns)]
        courses = [
            course.astype(np.float32, copy=False)
            for course in ladder.filtered(errors.drivers, starts)
        ]
        both = np.hstack([errors.patterns, floor.modes.axes])
        self.absorbed = np.zeros(errors.count)
        self.log_volume = 0.5 * sum(float(np.log1p(own @ own)) for own in held)
        self._blocks: list[tuple[Indices, tuple[Matrix, bool]]] = []
        for _, its in components(both):
            columns = its[its < errors.count]
            if len(columns):
                solver = self._solved(shapes, courses, columns, held)
                self._blocks.append((columns, solver))
                self.log_volume -= float(np.sum(np.log(np.diagonal(solver[0]))))

    def _solved(
        self,
        shapes: Sequence[Single],
        courses: Sequence[Single],
        columns: Indices,
        held: Sequence[Vector],
    ) -> tuple[Matrix, bool]:
        matrix = np.zeros((len(columns), len(columns)))
        for shape, course in zip(shapes, courses, strict=True):
            one = np.ascontiguousarray(shape[:, columns])
            other = np.ascontiguousarray(course[:, columns])
            matrix += (one.T @ one) * (other.T @ other)
        known = np.diagonal(matrix).copy()
        prior = np.eye(len(columns)) + sum(np.outer(one[columns], one[columns]) for one in held)
        matrix += prior
        try:
            solver = cho_factor(matrix, lower=True)
        except LinAlgError:  # rounding: what is known best is known a little less
            matrix[np.diag_indices_from(matrix)] += 1e-4 * known
            solver = cho_factor(matrix, lower=True)
        # J − J (J + Q)⁻¹ J = Q − Q (J + Q)⁻¹ Q is what is left of the information on every error.
        left = np.diagonal(prior) - np.einsum("ij,ij->j", prior, cho_solve(solver, prior))
        self.absorbed[columns] = np.clip(1.0 - left / np.maximum(known, 1e-12), 0.0, 1.0)
        return solver

    def solve(self, gradient: Vector) -> Vector:
        """Step to the top of the parabola that has this gradient, shape (P,)."""
        step = np.zeros_like(gradient)
        for columns, solver in self._blocks:
            step[columns] = cho_solve(solver, gradient[columns], check_finite=False)
        return step

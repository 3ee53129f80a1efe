"""Few steady filters in the place of one per mode, for patterns and drivers apart."""

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.diagnose.innovation import LEAST_MEMORY, OLDEST, NoiseFloor, stretches
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.quick import Single
from orbitfb.diagnose.recursion import Feedback
from orbitfb.physics.optics import Matrix


class Ladder:
    """Few steady filters in the place of one per mode: what scans over many places use.

    Modes of similar gain make a level; every level filters with the (geometric) mean gain. The
    energy that is left of a slow course, one that grows all the time, goes with 1/L² and is then
    wrong by factors (5 for what a slew rate leaves out). With `between` it is interpolated
    between two levels instead: right for the size of single changes, but no longer one filter
    that all changes share, so that what is alike in two changes comes out too small.

    Every stretch begins with an orbit that is not known, as for the modes themselves: without
    drift no gain is ever steady, and an orbit that is steered away at once shows in the first rows.

    Args:
        floor: The noise.
        levels: How many at most.
        between: Whether to interpolate.

    Attributes:
        feedback: 1 − L of every level.
    """

    def __init__(self, floor: NoiseFloor, levels: int = 6, *, between: bool = False) -> None:
        size = np.log(floor.gains)
        if between and np.ptp(size) > 1e-9:
            steps = np.exp(np.linspace(size.min(), size.max(), levels))
            corners = np.eye(levels)
            slowness = 1.0 / floor.gains  # the energy of a walk is linear in it
            self._share = [np.interp(-slowness, -1.0 / steps, corner) for corner in corners]
        else:
            edges = np.linspace(size.min(), size.max(), levels + 1)[1:-1]
            level = np.searchsorted(edges, size)
            self._share = [(level == k).astype(np.float64) for k in np.unique(level)]
            steps = np.array([np.exp(np.mean(size[share > 0])) for share in self._share])
        self.feedback = [1.0 - float(step) for step in steps]
        self._floor = floor
        # A random walk of q = r² L² / (1 − L) has the steady gain L.
        walk = steps**2 / np.maximum(1.0 - steps, LEAST_MEMORY)
        self._filters = NoiseFloor(NoiseModes.even(np.eye(len(steps))), 1.0, walk)

    def filtered(self, drivers: NDArray[np.floating], starts: Mask) -> list[Matrix]:
        """Filter courses in time with every level, each of shape (N, P), in single precision.

        They are over √S of their row, times the steady √S that `shapes` are over.
        """
        steps, pieces = row_steps(drivers, starts), stretches(starts)
        done: list[Matrix] = []
        for level in range(len(self.feedback)):
            recursion, sizes = self._recursion(level, starts)
            course = steps.copy()
            for own in pieces:
                recursion.forward(course[own])
                course[own] *= sizes[: own.stop - own.start]
            done.append(cast("Matrix", course))  # what it is multiplied with is double
        return done

    def begun(
        self, level: int, drivers: Matrix, first: Matrix, starts: Mask
    ) -> tuple[Matrix, Matrix]:
        """Energy of every course if it begins in a row, for every row, both of shape (N, P).

        It is nothing before, and from then on what it is in the record: the filter has seen none of
        its past, which the courses of `filtered` have in them.

        Args:
            level: Of the ladder.
            drivers: Courses in the record, shape (N, P).
            first: Step that each makes if it begins in a row, shape (N, P).
            starts: Where stretches begin, shape (N,).

        Returns:
            Σ of the squares of the filtered course, and that part of it which its first step makes.
        """
        recursion, sizes = self._recursion(level, starts)
        squared = Feedback.of(recursion.each.astype(np.float64) ** 2, np.float32)
        course = row_steps(drivers, starts)
        tail, lasting = np.empty_like(course), np.empty((len(course), 1), dtype=np.float32)
        energy = np.empty_like(course)
        for own in stretches(starts):
            weight = sizes[: own.stop - own.start] ** 2
            recursion.forward(course[own])
            tail[own] = weight * course[own]
            energy[own] = tail[own] * course[own]
            lasting[own] = weight
            recursion.backward(tail[own])
            squared.backward(lasting[own])
        tail[starts], lasting[starts] = 0.0, 0.0  # no step is seen where the orbit is not known
        step = first - course  # besides the one that the record has there
        total = np.cumsum(energy[::-1], axis=0, dtype=np.float64)[::-1]
        jump = lasting * step**2
        return total + 2.0 * step * tail + jump, jump

    def _recursion(self, level: int, starts: Mask) -> tuple[Feedback, Single]:
        """What a level passes on from row to row of a stretch, and its steady √S over √S (N, 1)."""
        longest = max((own.stop - own.start for own in stretches(starts)), default=0)
        feedback = self._filters.feedback_of(longest)[:, [level]]
        deviation = self._filters.deviation_of(longest)[:, [level]]
        sizes = self._filters.deviation_of(OLDEST)[-1, level] / deviation
        return Feedback.of(feedback, np.float32), sizes.astype(np.float32)

    def shapes(self, patterns: Matrix) -> list[Matrix]:
        """Rotate patterns (n, P) into the modes of every level, over √S, each (k, P) [1/m]."""
        modal = self._floor.seen(patterns)
        return [modal[share > 0] * np.sqrt(share[share > 0])[:, None] for share in self._share]


def information(
    shapes: Sequence[Matrix],
    courses: Sequence[Matrix],
    other_shapes: Sequence[Matrix] | None = None,
    other_courses: Sequence[Matrix] | None = None,
) -> Matrix:
    """Fisher information of amplitudes of changes pattern · driver, shape (P, P').

    Args:
        shapes: Of P patterns, from `Ladder.shapes`.
        courses: Of their drivers, from `Ladder.filtered`; one column stands for all.
        other_shapes: Of P' others; the same when None.
        other_courses: Of theirs.
    """
    right_shapes = shapes if other_shapes is None else other_shapes
    right_courses = courses if other_courses is None else other_courses
    total: Matrix | None = None
    for shape, course, right, moving in zip(
        shapes, courses, right_shapes, right_courses, strict=True
    ):
        part = (shape.T @ right) * (course.T @ moving)
        total = part if total is None else total + part
    return np.zeros((0, 0)) if total is None else total


def row_steps(drivers: NDArray[np.floating], starts: Mask) -> Single:
    """Change from row to row, none where a stretch begins.

    Differences of large numbers need double precision, what is made of them does not.
    """
    steps = np.zeros(drivers.shape, dtype=np.float32)
    np.subtract(drivers[1:], drivers[:-1], out=steps[1:], casting="same_kind")
    steps[starts] = 0.0
    return steps

"""Terms that add to the readings: patterns over the BPMs times courses in time."""

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Indices, Matrix, StepTransform

Single = NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """k columns, column c being patterns[:, pattern[c]] ⊗ course c, told by its spectrum.

    Args:
        patterns: Different patterns, shape (n, P) [m].
        pattern: Which of them a column has, shape (k,).
        spectrum: Transformed steps of the courses, shape (T, k), column after column in memory.
        grams: Σ_f∈b course_c(f) course_c'(f), shape (B, k, k): in double precision, because
            courses of neighbours are nearly alike.
    """

    patterns: Matrix
    pattern: Indices
    spectrum: Single
    grams: Matrix

    @classmethod
    def of(
        cls, patterns: Matrix, pattern: Indices, courses: Matrix, transform: StepTransform
    ) -> "Terms":
        """Transform courses, shape (N, k), and sum their products by band."""
        spectrum = spectrum_of(courses, transform)
        return cls(patterns, pattern, spectrum, _grams(spectrum, transform))

    def __len__(self) -> int:
        return len(self.pattern)

    def beside(
        self, patterns: Matrix, pattern: Indices, courses: Matrix, transform: StepTransform
    ) -> "Terms":
        """These columns and others behind them."""
        spectrum = np.asfortranarray(np.hstack([self.spectrum, transform.quick_spectrum(courses)]))
        return Terms(
            np.hstack([self.patterns, patterns]),
            np.concatenate([self.pattern, self.patterns.shape[1] + pattern]),
            spectrum,
            _grams(spectrum, transform),
        )

    def instead(self, first: Matrix, transform: StepTransform, kept: Mask) -> "Terms":
        """Columns of the same patterns with other courses instead of the first ones of these.

        Args:
            first: The other courses, shape (N, k').
            transform: Of the record.
            kept: Columns that stay as they are, shape (k,).
        """
        spectrum, fresh = self.spectrum.copy(order="F"), ~kept[: first.shape[1]]
        spectrum[:, : len(fresh)][:, fresh] = spectrum_of(first, transform)[:, fresh]
        return Terms(self.patterns, self.pattern, spectrum, _grams(spectrum, transform))

    def pull(
        self, pulled: "Matrix | Single", used: Mask | None = None, patterns: Single | None = None
    ) -> Vector:
        """Σ_f (pattern · Ω z)_f course_f of every column, shape (k,).

        Args:
            pulled: Ω_f z_f, shape (T, n) [1/m].
            used: Columns that are asked for, shape (k,); the others are zero. None: all.
            patterns: What the patterns are in other coordinates, if `pulled` is in those, (n, P).
        """
        found = np.zeros(len(self))
        seen = (self.patterns if patterns is None else patterns).astype(np.float32)
        turned = np.ascontiguousarray(pulled.astype(np.float32).T)
        along: dict[tuple[int, int], Single] = {}
        for part in self._runs():
            if used is not None and not np.any(used[part]):
                continue
            its = self._along(part)
            if its not in along:
                along[its] = seen[:, slice(*its)].T @ turned
            found[part] = np.einsum("cf,cf->c", along[its], self.spectrum.T[part])
        return found

    def applied(self, sizes: Vector, seen: Single, variance: Single, used: Mask) -> Vector:
        """What given sizes pull at the columns: their exact information times the sizes, (k,).

        Args:
            sizes: Shape (k,).
            seen: Patterns in the modes that part walk and noise, shape (n, P).
            variance: Of every mode at every frequency, shape (T, n).
            used: Columns that are asked for, shape (k,); the others are zero.
        """
        return self.pull((self._by_pattern(sizes) @ seen.T) / variance, used, seen)

    def _runs(self) -> list[slice]:
        """Columns whose patterns follow one another, so cut that no two runs share some of them.

        What is worked out for the patterns of one run serves all others that have the same.
        """
        if not len(self):
            return []
        begins = np.flatnonzero(np.diff(self.pattern, prepend=-2) != 1)
        ends = np.append(begins[1:], len(self)) - 1
        edges = np.concatenate([self.pattern[begins], self.pattern[ends] + 1])
        cuts = np.flatnonzero(np.isin(self.pattern, edges))
        cuts = np.union1d(begins, cuts)
        return [slice(a, b) for a, b in itertools.pairwise([*cuts.tolist(), len(self)])]

    def information(
        self, noise: StepNoise, transform: StepTransform, wanted: Mask | None = None
    ) -> Matrix:
        """Σ_b (Pᵀ Ω_b P) ∘ (courseᵀ course)_b of all pairs of columns, shape (k, k).

        Args:
            noise: The floor.
            transform: Of the record.
            wanted: Columns that are asked for, shape (k,); runs with none of them are zero. None:
                all.
        """
        seen = self.patterns.T @ noise.modes
        total = np.zeros((len(self), len(self)))
        inverse = noise.inverse_variance(transform)
        runs = [(part, self._along(part)) for part in self._runs()]
        if wanted is not None:
            runs = [one for one in runs if np.any(wanted[one[0]])]
        pairs = list(itertools.combinations_with_replacement(runs, 2))
        for weight, gram in zip(inverse, self.grams, strict=True):
            weighed = seen * weight
            known: dict[tuple[tuple[int, int], tuple[int, int]], Matrix] = {}
            for (row, mine), (column, theirs) in pairs:
                if (mine, theirs) not in known:
                    known[mine, theirs] = weighed[slice(*mine)] @ seen[slice(*theirs)].T
                total[row, column] += known[mine, theirs] * gram[row, column]
        for (row, _), (column, _) in pairs:
            total[column, row] = total[row, column].T
        return total

    def _along(self, run: slice) -> tuple[int, int]:
        """First pattern of a run, and the one behind its last."""
        begin = int(self.pattern[run.start])
        return begin, begin + run.stop - run.start

    def cross(
        self,
        noise: StepNoise,
        transform: StepTransform,
        patterns: Matrix,
        spectrum: Single,
        used: Mask,
    ) -> Matrix:
        """Information between the columns and others, shape (k, k').

        Args:
            noise: The floor.
            transform: Of the record.
            patterns: Of the others, shape (n, P').
            spectrum: Of their courses, shape (T, k'): once through the patterns, or several times.
            used: Columns that are asked for, shape (k,); runs with none of them are zero.
        """
        seen, others = (
            (its.T @ noise.modes).astype(np.float32) for its in (self.patterns, patterns)
        )
        inverse = noise.inverse_variance(transform).astype(np.float32)
        turns = spectrum.shape[1] // max(patterns.shape[1], 1)
        total = np.zeros((len(self), turns, patterns.shape[1]), dtype=np.float32)
        runs = [(part, self._along(part)) for part in self._runs() if np.any(used[part])]
        for band, weight in enumerate(inverse):
            rows = transform.members(band)
            known = {its: (seen[slice(*its)] * weight) @ others.T for _, its in runs}
            theirs = spectrum[rows]
            for part, its in runs:
                product = (self.spectrum[rows, part].T @ theirs).reshape(-1, *total.shape[1:])
                product *= known[its][:, None]
                total[part] += product
        return total.reshape(len(self), -1).astype(np.float64)

    def scatter(self, covariance: Matrix) -> Matrix:
        """Second moments by band of what sizes of a covariance add, shape (B, n, n) [m²]."""
        runs = [(part, self._along(part)) for part in self._runs()]
        pairs = list(itertools.combinations_with_replacement(runs, 2))
        count = self.patterns.shape[1]
        found = np.empty((len(self.grams), len(self.patterns), len(self.patterns)))
        for band, gram in enumerate(self.grams):
            half = np.zeros((count, count))  # the other half is its transpose
            for (row, mine), (column, theirs) in pairs:
                share = covariance[row, column] * gram[row, column]
                half[slice(*mine), slice(*theirs)] += 0.5 * share if row == column else share
            mixed = self.patterns @ half @ self.patterns.T
            found[band] = mixed + mixed.T
        return found

    def contribution(self, sizes: Vector) -> Matrix:
        """Spectrum of what given sizes add to the readings, shape (T, n) [m]."""
        return self._by_pattern(sizes).astype(np.float64) @ self.patterns.T

    def _by_pattern(self, sizes: Vector) -> Single:
        """The same along every pattern, shape (T, P)."""
        found = np.zeros((self.patterns.shape[1], len(self.spectrum)), dtype=np.float32)
        single = sizes.astype(np.float32)[:, None]
        for part in self._runs():
            if np.any(sizes[part]):
                found[slice(*self._along(part))] += self.spectrum.T[part] * single[part]
        return found.T


def spectrum_of(courses: Matrix, transform: StepTransform) -> Single:
    """Transformed steps of courses, shape (N, k): (T, k), column after column in memory."""
    return np.asfortranarray(transform.spectrum(courses).astype(np.float32))


def _grams(spectrum: Single, transform: StepTransform) -> Matrix:
    """Products of courses by band, shape (B, k, k), of their spectrum, shape (T, k)."""
    count = spectrum.shape[1]
    found = np.empty((len(transform.count), count, count))
    for band, its in enumerate(found):
        part = spectrum[transform.members(band)].astype(np.float64)
        np.matmul(part.T, part, out=its)
    return found

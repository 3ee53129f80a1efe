"""Steps from row to row in sine transform: where the noise of a record is independent.

Readings z = y − y_model follow a walk w of the orbit beside reading noise v: their steps are
Δz_n = w_n + v_n − v_{n−1}. In an unbroken stretch of L steps the orthonormal sine transform
(DST-I) makes the covariance of the steps **exactly** Q + λ_f N with λ_f = 2 − 2 cos(π f/(L+1)),
independent from frequency to frequency: Q the covariance of the walk, N that of the reading noise
(G. Strang, SIAM Review 41 (1999) 135, on the eigenvectors of the second difference).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dst, prev_fast_len

from orbitfb.core.signals import Mask, Vector

Matrix = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class StepTransform:
    """The sine transform of the steps of a record in unbroken stretches.

    Args:
        rows: Count N of rows.
        begins: First row of every stretch, shape (S,).
        pieces: Steps that are transformed together, in order.
        eigenvalue: λ_f of every frequency, piece by piece, shape (T,), T = N − S.
        band: Band of every frequency, shape (T,).
        count: Frequencies in every band, shape (B,).
    """

    rows: int
    begins: Indices
    pieces: tuple[slice, ...]
    eigenvalue: Vector
    band: Indices
    count: Indices

    @classmethod
    def of(cls, starts: Mask, bands: int | None = 20, exact: bool = False) -> "StepTransform":
        """Lay out the transform.

        A stretch whose length has large prime factors is cut in two, because its transform would
        take ten times as long: all steps stay, what is lost is the correlation −N of the two steps
        beside the cut, one of thousands.

        Args:
            starts: Whether a row begins a stretch, shape (N,); the first row does.
            bands: Into how many bands of λ to sort the frequencies, logarithmic in λ from the
                slowest one on: where nothing walks, its weight is that of no other. None: every
                value of λ is a band of its own, so that sums by band are exact.
            exact: Leave every stretch whole.
        """
        begins = np.flatnonzero(starts)
        ends = np.append(begins[1:], len(starts))
        pieces: list[slice] = []
        for begin, end in zip(begins, ends, strict=True):
            first, left = pieces[-1].stop if pieces else 0, int(end - begin) - 1
            while left > 0:
                part = left if exact else _fast(left)
                pieces.append(slice(first, first + part))
                first, left = first + part, left - part
        eigenvalue = np.concatenate([_eigenvalues(one.stop - one.start) for one in pieces] or [[]])
        if bands is None:
            _, band = np.unique(eigenvalue, return_inverse=True)
        else:
            edges = np.geomspace(np.min(eigenvalue, initial=4.0), 4.0, bands + 1)[1:-1]
            _, band = np.unique(np.searchsorted(edges, eigenvalue), return_inverse=True)
        count = np.bincount(band)
        return cls(len(starts), begins, tuple(pieces), eigenvalue, band, count)

    def band_levels(self) -> Vector:
        """Mean λ of every band, shape (B,)."""
        return np.bincount(self.band, self.eigenvalue) / self.count

    def __len__(self) -> int:
        return len(self.eigenvalue)

    @property
    def stretches(self) -> list[slice]:
        """Rows of every stretch."""
        ends = np.append(self.begins[1:], self.rows)
        pairs = zip(self.begins, ends, strict=True)
        return [slice(int(begin), int(end)) for begin, end in pairs]

    def members(self, band: int) -> Indices:
        """Frequencies of a band."""
        return np.flatnonzero(self.band == band)

    def sample(self, most: int) -> tuple[Indices, Vector]:
        """Frequencies, evenly from every band, and how many each stands for, shape (k,) both.

        Args:
            most: Of a band, about; all of one that has fewer.
        """
        bands = [self.members(band) for band in range(len(self.count))]
        # An odd distance: a course that is symmetric has nothing at every other frequency.
        some = [one[:: len(one) // most | 1] for one in bands]
        share = [
            np.full(len(part), len(one) / len(part)) for one, part in zip(bands, some, strict=True)
        ]
        return np.concatenate(some), np.concatenate(share)

    def by_band(self, values: NDArray[np.floating]) -> NDArray[np.floating]:
        """Sum over the frequencies of every band, shape (B, k) of (T, k)."""
        member = np.zeros((len(self.count), len(self)), dtype=values.dtype)
        member[self.band, np.arange(len(self))] = 1.0
        return np.asarray(member @ values)

    def steps(self, courses: Matrix) -> Matrix:
        """Differences of neighbouring rows of a stretch, shape (T, k) of (N, k)."""
        difference = np.diff(courses, axis=0)
        if len(self.begins) == 1:
            return difference
        return np.delete(difference, self.begins[1:] - 1, axis=0)

    def step_rows(self) -> Indices:
        """Row at which every step ends, shape (T,)."""
        return np.delete(np.arange(self.rows), self.begins)

    def turn(self, steps: NDArray[np.floating]) -> Matrix:
        """Transform steps to frequencies, or back: the transform is its own inverse."""
        turned = np.empty(steps.shape)
        for part in self.pieces:
            turned[part] = np.asarray(dst(steps[part], type=1, axis=0, norm="ortho"))
        return turned

    def at_rows(self, weights: Vector) -> Vector:
        """Weight of a step at every row, from those of the frequencies, shape (T,) both.

        With S the transform it is the diagonal of S diag(w) S.
        """
        found = np.empty_like(weights)
        for part in self.pieces:
            own = weights[part]
            cosine = np.fft.rfft(np.concatenate([[0.0], own]))
            found[part] = own.sum() - _mirrored(cosine.real, len(own))
            found[part] /= len(own) + 1
        return found

    def summed(self, spectrum: Matrix) -> Matrix:
        """Courses of which a spectrum is that of the steps, zero where a stretch begins, (N, k)."""
        steps = self.turn(spectrum)
        courses = np.zeros((self.rows, steps.shape[1]))
        courses[self.step_rows()] = steps
        for part in self.stretches:
            courses[part] = np.cumsum(courses[part], axis=0)
        return courses

    def quick_spectrum(self, courses: Matrix) -> NDArray[np.float32]:
        """`spectrum` in single precision, for scans: half the time, right to six digits."""
        steps = self.steps(courses).astype(np.float32)
        turned = np.empty_like(steps)
        for part in self.pieces:
            turned[part] = np.asarray(dst(steps[part], type=1, axis=0, norm="ortho"))
        return turned

    def spectrum(self, courses: Matrix) -> Matrix:
        """Transformed steps of courses, shape (T, k) of (N, k)."""
        return self.turn(self.steps(courses))


def _mirrored(half: Vector, count: int) -> Vector:
    """Values 1 to `count` of a real transform of length count + 1, of which a half is given."""
    number = np.arange(1, count + 1)
    return half[np.minimum(number, count + 1 - number)]


def _fast(count: int) -> int:
    """Largest number of steps up to a count whose sine transform is quick."""
    return max(int(prev_fast_len(count + 1) or 0) - 1, 1)


def _eigenvalues(count: int) -> Vector:
    return 2.0 - 2.0 * np.cos(np.pi * np.arange(1, count + 1) / (count + 1))

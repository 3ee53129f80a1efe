"""Sums over rows instead of frequencies: what begins late is weighed from its beginning on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Indices, Matrix, StepTransform

Turned = NDArray[np.complex128]

_ALIKE = 4.0
"""Ratio of the walk over noise within which modes share one whitening filter for onsets [1]: the
weight of none is off by more than two, and sums along a pattern by less than a sixth."""

_STILL = 1e-5
"""Walk over noise below which all modes are alike: λ of the slowest frequency of a record [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class OwnError:
    """The healthy error of some devices, each for itself.

    Args:
        first: Number of the first of its columns among all errors.
        spectrum: Transformed steps of its courses, shape (T, k).
        whitened: The same from row to row, by the root of the filter, shape (T, k) each.
        variance: Of its size before the record is seen, shape (k,).
        information: Of its size, shape (k,).
    """

    first: int
    spectrum: Single
    whitened: Mapping[float, Matrix]
    variance: Vector
    information: Vector

    def of(self, devices: Indices) -> "OwnError":
        """That of some of the devices."""
        return replace(
            self,
            spectrum=self.spectrum[:, devices],
            whitened={root: one[:, devices] for root, one in self.whitened.items()},
            variance=self.variance[devices],
            information=self.information[devices],
        )

    def marginal(self, information: Vector, cross: Vector, own: Vector | None = None) -> Vector:
        """Information of other courses of the devices with the error marginalised.

        Args:
            information: Of the courses.
            cross: Between them and the error.
            own: Of the error, summed as those are; None: by frequency. A course that is nearly the
                error's would else seem to have no information left, or less.
        """
        known = np.where(self.variance > 0.0, 1.0 / np.maximum(self.variance, 1e-300), np.inf)
        its = self.information if own is None else own
        return np.maximum(information - cross**2 / (known + its), 0.0)


def whitened_by(steps: Matrix, root: float) -> Matrix:
    """Innovations of steps whose moving average has a root: ε_n = Δ_n + r ε_{n−1}."""
    return np.asarray(lfilter([1.0], [1.0, -root], steps, axis=0))


def moving_root(ratio: Vector) -> Vector:
    """Root r of the moving average that the steps of a walk and its noise are.

    Its covariance q + 2 at lag 0 and −1 at lag 1 is (1 + r²)/r and −1.

    Args:
        ratio: q, walk over noise.
    """
    # 1 + q/2 − √(q + q²/4), in the form that a large q does not cancel
    return 1.0 / (1.0 + ratio / 2.0 + np.sqrt(ratio + ratio**2 / 4.0))


def sums_since(values: Matrix, onsets: Indices) -> Matrix:
    """Sums from every onset to the end, shape (O, D)."""
    parts = np.add.reduceat(values, onsets, axis=0)
    return np.cumsum(parts[::-1], axis=0)[::-1]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """What a workspace leaves, weighed, from row to row.

    Args:
        noise: The floor.
        transform: Of the record.
        late: Ω z, each λ for itself, shape (T, n) [1/m].
        roots: Root r of the moving average of every group of modes, shape (G,).
        groups: Modes of every group.
        turned: Fourier transform of `late` with so many frequencies per that of its length.
    """

    noise: StepNoise
    transform: StepTransform
    late: Matrix
    roots: Vector
    groups: tuple[Indices, ...]
    turned: dict[int, Turned] = field(default_factory=dict)

    @classmethod
    def of(cls, left: Matrix, noise: StepNoise, transform: StepTransform) -> "Rows":
        """Weigh a spectrum, shape (T, n) [m]."""
        bent = np.log(np.maximum(noise.ratio, _STILL))
        number = np.floor(bent / np.log(_ALIKE))
        groups = tuple(np.flatnonzero(number == one) for one in np.unique(number))
        typical = np.array([np.exp(np.mean(bent[one])) for one in groups])
        late = transform.turn(noise.pull(left, transform))
        return cls(noise, transform, late, moving_root(typical), groups)

    def fourier(self, finer: int) -> Turned:
        """Fourier transform of `late` over its rows, shape (F, n).

        Args:
            finer: Frequencies per that of the record's length.
        """
        if finer not in self.turned:
            self.turned[finer] = np.fft.rfft(self.late, n=finer * len(self.late), axis=0)
        return self.turned[finer]

    def without(self, field: "Matrix | Single") -> Matrix:
        """Ω z from row to row without a field, shape (T, n) [1/m].

        Args:
            field: Spectrum of what it adds to the readings, shape (T, n) [m].
        """
        modes = self.noise.modes.astype(np.float32)
        variance = self.noise.variance(self.transform).astype(np.float32)
        pulled = ((field.astype(np.float32) @ modes) / variance) @ modes.T
        return self.late - self.transform.turn(pulled)

    def drive_pull(self, response: Matrix) -> Matrix:
        """∂log L/∂current of every corrector at every row, shape (N, m) [1/A].

        Args:
            response: Of the ring, shape (n, m) [m/A].
        """
        transform = self.transform
        along = self.late @ response
        rows = transform.step_rows()
        pull = np.zeros((transform.rows, along.shape[1]))
        pull[rows] += along
        pull[rows - 1] -= along
        return pull

    def whitened(self, steps: Matrix) -> dict[float, Matrix]:
        """Innovations of steps in every group of modes, by its root."""
        return {float(root): whitened_by(steps, float(root)) for root in self.roots}

    def since(
        self,
        pattern: Matrix,
        steps: Matrix,
        onsets: Indices,
        own: OwnError | None,
        sets: Sequence[Indices] = (),
    ) -> tuple[Matrix, Matrix]:
        """Pull and information of what is left of courses that begin late.

        A course that begins at a row has the steps after it. Its information is that of the
        whitened steps, ε_n = Δ_n + r ε_{n−1}, r the root of the mode's moving average. Errors of
        its devices take from a set the share that each takes from its own device.

        Args:
            pattern: Shape (n, D) [m].
            steps: Of the courses, shape (T, D).
            onsets: Steps at which they begin, shape (O,).
            own: Healthy error of the devices, which is marginalised.
            sets: Devices that begin together.

        Returns:
            Pull and information of every device, then of every set, shape (O, D + S) each.
        """
        pull = sums_since((self.late @ pattern) * steps, onsets)
        modes = pattern.T @ self.noise.modes
        alone, cross = np.zeros_like(pull), np.zeros_like(pull)
        usual, square = np.zeros(pull.shape[1]), np.zeros((len(steps), len(sets)))
        for root, group in zip(self.roots, self.groups, strict=True):
            seen = modes[:, group]
            weight = root * np.sum(seen**2, axis=1)
            whitened = whitened_by(steps, float(root))
            alone += weight * sums_since(whitened**2, onsets)
            if own is not None:
                beside = own.whitened[float(root)]
                cross += weight * sums_since(whitened * beside, onsets)
                usual += weight * np.sum(beside**2, axis=0)
            for number, its in enumerate(sets):
                course, along = whitened[:, its].astype(np.float32), seen[its].astype(np.float32)
                square[:, number] += root * np.sum((course @ (along @ along.T)) * course, axis=1)
        information = alone if own is None else own.marginal(alone, cross, usual)
        pulls, left = [pull], [information]
        for its, whole in zip(sets, sums_since(square, onsets).T, strict=True):
            share = information[:, its].sum(axis=1) / np.maximum(alone[:, its].sum(axis=1), 1e-300)
            pulls.append(pull[:, its].sum(axis=1, keepdims=True))
            left.append((share * whole)[:, None])
        return np.hstack(pulls), np.hstack(left)

    def weighed(
        self, pattern: Vector, steps: Matrix, own: OwnError | None, late: Matrix | None = None
    ) -> tuple[Vector, Vector]:
        """Pull and information of several courses of one pattern, each for itself.

        Args:
            pattern: Shape (n,) [m].
            steps: Of the courses, shape (T, k).
            own: Healthy error of the device, which is marginalised.
            late: Ω z from row to row, shape (T, n); None: that of all that is left to explain.
        """
        pull = ((self.late if late is None else late) @ pattern) @ steps
        seen = (pattern @ self.noise.modes) ** 2
        information, cross = np.zeros(len(pull)), np.zeros(len(pull))
        usual = np.zeros(1)
        for root, group in zip(self.roots, self.groups, strict=True):
            weight = root * float(seen[group].sum())
            whitened = whitened_by(steps, float(root))
            information += weight * np.sum(whitened**2, axis=0)
            if own is not None:
                beside = own.whitened[float(root)]
                cross += weight * np.sum(whitened * beside, axis=0)
                usual += weight * np.sum(beside**2, axis=0)
        return pull, information if own is None else own.marginal(information, cross, usual)

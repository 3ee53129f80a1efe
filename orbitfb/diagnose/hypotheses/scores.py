"""Pull and information of device laws, from one spectrum of courses."""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.transform import Indices, Matrix

_GROUPS = 3
"""Groups of modes, by the walk over the noise, that share one whitening filter for onsets."""


@dataclass(frozen=True, slots=True, eq=False)
class Scorer:
    """What a workspace says of columns pattern ⊗ course.

    Args:
        space: The record, its floor and what was accepted.
        pulled: Ω z with healthy errors marginalised, shape (T, n) [1/m].
        late: The same from row to row instead of by frequency, shape (T, n).
        errors: The healthy errors, as the residual pulls at them.
        roots: Root r of the moving average of every group of modes, shape (G,).
        groups: Modes of every group.
    """

    space: Workspace
    pulled: Matrix
    late: Matrix
    errors: NormalTerms
    roots: Vector
    groups: tuple[Indices, ...]

    @classmethod
    def of(cls, space: Workspace) -> "Scorer":
        """Weigh what a workspace leaves."""
        errors = space.errors
        left = space.residual - space.terms.contribution(errors.mean())
        pulled = space.noise.pull(left, space.transform)
        ratio = space.noise.ratio
        groups = tuple(np.array_split(np.argsort(ratio), _GROUPS))
        typical = np.array([np.exp(np.mean(np.log(ratio[one] + 1e-6))) for one in groups])
        return cls(
            space, pulled, space.transform.turn(pulled), errors, moving_root(typical), groups
        )

    def evaluate(self, fields: "list[Matrix]") -> tuple[Vector, Matrix]:
        """Pull and information of whole fields, healthy errors marginalised.

        Args:
            fields: Spectra of what each adds to the readings, shape (T, n) each [m].

        Returns:
            a, shape (k,), and H, shape (k, k).
        """
        noise, transform = self.space.noise, self.space.transform
        weighed = [noise.pull(one, transform) for one in fields]
        pull = np.array([float(np.sum(self.pulled * one)) for one in fields])
        information = np.array([[float(np.sum(a * b)) for b in fields] for a in weighed])
        if not len(self.errors.used):
            return pull, information
        cross = np.stack([self.space.terms.pull(one) for one in weighed], axis=1)
        _, beyond = self.errors.beyond(np.zeros(len(fields)), information, cross)
        return pull, beyond

    def score(
        self, patterns: tuple[Matrix, ...], courses: tuple[Matrix, ...]
    ) -> tuple[Vector, Matrix]:
        """Pull (D,) and information (D, D) of devices; healthy errors are not taken off the latter.

        Args:
            patterns: Blocks of shape (n, D) [m].
            courses: Blocks of shape (N, D) or (N, 1).
        """
        transform, noise = self.space.transform, self.space.noise
        inverse = noise.inverse_variance(transform)
        seen = [(one.T @ noise.modes).astype(np.float32) for one in patterns]
        spectra = [transform.quick_spectrum(course) for course in courses]
        count = patterns[0].shape[1]
        pull, information = np.zeros(count), np.zeros((count, count))
        members = [transform.members(band) for band in range(len(transform.count))]
        for one, pattern, spectrum in zip(seen, patterns, spectra, strict=True):
            along = self.pulled @ pattern
            pull += np.einsum("fd,fd->d", along, np.broadcast_to(spectrum, along.shape))
            for other, across in zip(seen, spectra, strict=True):
                for weight, rows in zip(inverse, members, strict=True):
                    precision = (one * weight.astype(np.float32)) @ other.T
                    information += precision * (spectrum[rows].T @ across[rows])
        return pull, information

    def since(self, pattern: Matrix, course: Matrix, every: int) -> tuple[Vector, Vector, Indices]:
        """Pull and information of what is left of courses that begin late.

        A course that begins at a row has the steps after it. Its information is that of the
        whitened steps, ε_n = Δ_n + r ε_{n−1}, r the root of the mode's moving average.

        Args:
            pattern: Shape (n, D) [m].
            course: Shape (N, D) or (N, 1).
            every: Distance of the onsets, in steps.

        Returns:
            Pull (O, D), information (O, D), and the steps O at which the courses begin.
        """
        transform, noise = self.space.transform, self.space.noise
        steps = transform.steps(course)
        onsets = np.arange(0, len(steps), every)
        along = (self.late @ pattern) * steps
        pull = _suffix(along, onsets)
        seen = (pattern.T @ noise.modes) ** 2
        information = np.zeros_like(pull)
        for root, group in zip(self.roots, self.groups, strict=True):
            whitened = _whitened(steps, float(root))
            information += root * seen[:, group].sum(axis=1) * _suffix(whitened**2, onsets)
        return pull, information, onsets

    def apart(self, patterns: Matrix, course: Matrix) -> tuple[Vector, Vector]:
        """Pull and information of every device for itself, in the whitening of its modes together.

        Args:
            patterns: Shape (n, D) [m].
            course: Shape (N, D) or (N, 1).
        """
        steps = self.space.transform.steps(course)
        pull = np.einsum(
            "td,td->d",
            self.late @ patterns,
            np.broadcast_to(steps, (len(steps), patterns.shape[1])),
        )
        seen = (patterns.T @ self.space.noise.modes) ** 2
        weight = np.stack([seen[:, group].sum(axis=1) for group in self.groups])
        root = float(np.sum(weight.sum(axis=1) * self.roots) / np.sum(weight))
        whitened = _whitened(steps, float(root))
        return pull, root * weight.sum(axis=0) * np.sum(whitened**2, axis=0)

    def quick(self, pattern: Matrix, course: Matrix) -> tuple[Vector, Vector]:
        """Pull and information of several courses of one pattern, each for itself.

        Args:
            pattern: Shape (n,) [m].
            course: Shape (N, k).
        """
        steps = self.space.transform.steps(course)
        pull = (self.late @ pattern) @ steps
        seen = (pattern @ self.space.noise.modes) ** 2
        information = np.zeros(len(pull))
        for root, group in zip(self.roots, self.groups, strict=True):
            whitened = _whitened(steps, float(root))
            information += root * float(seen[group].sum()) * np.sum(whitened**2, axis=0)
        return pull, information


def _whitened(steps: Matrix, root: float) -> Matrix:
    """Innovations of steps whose moving average has a root: ε_n = Δ_n + r ε_{n−1}."""
    return np.asarray(lfilter([1.0], [1.0, -root], steps, axis=0))


def moving_root(ratio: Vector) -> Vector:
    """Root r of the moving average that the steps of a walk and its noise are.

    Its covariance q + 2 at lag 0 and −1 at lag 1 is (1 + r²)/r and −1.

    Args:
        ratio: q, walk over noise.
    """
    return 1.0 + ratio / 2.0 - np.sqrt(ratio + ratio**2 / 4.0)


def _suffix(values: Matrix, onsets: Indices) -> Matrix:
    """Sums from every onset to the end, shape (O, D)."""
    parts = np.add.reduceat(values, onsets, axis=0)
    return np.cumsum(parts[::-1], axis=0)[::-1]

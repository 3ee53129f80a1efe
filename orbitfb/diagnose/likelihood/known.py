"""What a floor says of the columns of the healthy errors: worked out once, kept while it holds."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.likelihood.terms import Terms
from orbitfb.estimation.evidence import NormalPriors
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class Saturated:
    """All columns free within wide limits: what a floor is estimated beside.

    Args:
        variance: Of every column before the record is seen, shape (k,).
        priors: With the information of the columns, factored.
        scatter: Second moments by band of what remains unknown of the columns, (B, n, n) [m²].
    """

    variance: Vector
    priors: NormalPriors
    scatter: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Known:
    """Information of columns under a floor.

    Args:
        noise: The floor.
        information: Of the columns, shape (k, k).
        columns: Which of them it knows, shape (k,); the others are zero.
        free: The saturated model, if it was asked for.
    """

    noise: StepNoise
    information: Matrix
    columns: Mask
    free: Saturated | None = None

    @classmethod
    def nothing(cls, noise: StepNoise) -> "Known":
        """Nothing yet."""
        return cls(noise, np.zeros((0, 0)), np.zeros(0, dtype=bool))

    def of(self, noise: StepNoise, terms: Terms, transform: StepTransform, wanted: Mask) -> "Known":
        """The same if it knows these columns under this floor, else what it says of them.

        Args:
            noise: The floor.
            terms: The columns.
            transform: Of the record.
            wanted: Columns that are asked for, shape (k,).
        """
        holds = self.noise is noise and len(self.columns) == len(wanted)
        if holds and not np.any(wanted & ~self.columns):
            return self
        return Known(noise, terms.information(noise, transform, wanted), wanted)

    def beside(self, terms: Terms, variance: Vector) -> "Known":
        """The same with a saturated model.

        Args:
            terms: The columns, all of which are known.
            variance: Of every column before the record is seen, shape (k,).
        """
        if self.free is not None and np.array_equal(self.free.variance, variance):
            return self
        its = NormalPriors.of(self.information, variance)
        scatter = terms.scatter(its.covariance(len(variance)))
        return replace(self, free=Saturated(variance, its, scatter))

    @property
    def saturated(self) -> Saturated:
        """The saturated model; `beside` was asked for it."""
        if self.free is None:
            raise ValueError("no saturated model was asked for: call `beside` first")
        return self.free

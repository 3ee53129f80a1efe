"""What patterns, and errors that are marginalised, see of a residual."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """Errors of some devices, for marginalising them.

    Args:
        modes: Patterns of the columns in the modes of the noise, shape (e, n).
        spectrum: Of their courses, shape (T, e).
        scale: Their prior standard deviations, shape (e,).
        factor: Cholesky factor of 1 + scale · information · scale.
    """

    modes: Single
    spectrum: Single
    scale: Vector
    factor: tuple[Matrix, bool]

    @classmethod
    def of(cls, space: Workspace, errors: NormalTerms, columns: Indices) -> "Beside":
        """Gather columns.

        Args:
            space: Whose columns they are.
            errors: All of them, as the residual pulls at them.
            columns: Numbers of those that are marginalised.
        """
        terms = space.terms
        patterns = terms.patterns[:, terms.pattern[columns]]
        scale = np.sqrt(errors.variance[columns])
        inner = scale[:, None] * errors.information[np.ix_(columns, columns)] * scale
        inner[np.diag_indices_from(inner)] += 1.0
        return cls(
            (patterns.T @ space.noise.modes).astype(np.float32),
            terms.spectrum[:, columns], scale, cho_factor(inner, lower=True),
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """What D patterns see of the residual, in single precision.

    Args:
        source: The patterns, shape (n, D) [m].
        modes: In the modes of the noise, shape (D, n).
        pulled: Ω z along them, by frequency, shape (T, D).
        precision: Pᵀ Ω P of every band, B of shape (D, D).
        own: Pᵀ Ω P of every pattern for itself in every band, shape (B, D).
    """

    source: Matrix
    modes: Single
    pulled: Single
    precision: list[Single]
    own: Single

    @classmethod
    def of(cls, patterns: Matrix, noise_modes: Matrix, inverse: Single, pulled: Matrix) -> "Seen":
        """Look along patterns.

        Args:
            patterns: Shape (n, D) [m].
            noise_modes: Modes that part walk and noise, shape (n, n) [1/m].
            inverse: Mean inverse variance of every mode in every band, shape (B, n).
            pulled: Ω z by frequency, shape (T, n) [1/m].
        """
        modes = (patterns.T @ noise_modes).astype(np.float32)
        precision = [(modes * weight) @ modes.T for weight in inverse]
        single = patterns.astype(np.float32)
        return cls(
            patterns, modes,
            pulled.astype(np.float32) @ single, precision,
            np.stack([np.diag(one) for one in precision]),
        )  # fmt: skip


def products(weighed: Sequence[Single], seen: Sequence[Single]) -> Matrix:
    """Sums of the products of all pairs, in double precision, shape (k, k)."""
    return np.array([[np.einsum("tn,tn->", a, b, dtype=float) for b in seen] for a in weighed])


def positive(information: Matrix) -> Matrix:
    """Keep what rounding leaves of no information from being less than none."""
    least = np.zeros_like(information)
    least[np.diag_indices_from(least)] = np.maximum(-np.diag(information), 0.0)
    return information + least


def semidefinite(information: Matrix) -> Matrix:
    """Keep what rounding leaves of no information, in whatever direction, from being negative."""
    size, modes = np.linalg.eigh(information)
    return (modes * np.maximum(size, 0.0)) @ modes.T

"""Covariance of the steps of readings: a walk, and noise that comes and goes."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import eigh

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.colour import changed, ramps
from orbitfb.estimation.priors import OCTAVES
from orbitfb.estimation.transform import Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class StepNoise:
    """Walk covariance Q and noise covariance N of n readings, and the modes that part them.

    W solves Wᵀ N W = 1, Wᵀ Q W = diag(q): in the modes z W the covariance of a step of frequency f
    is diag(q + λ_f). Where the ground drifts more smoothly than a walk, or springs back, it is
    diag(q r_f + λ_f). The logarithm of r is zero on average over all frequencies, and changes from
    one octave to the next (`colour`).

    Args:
        walk: Q, shape (n, n) [m²].
        white: N, shape (n, n) [m²], positive definite.
        shaken: Part of N that several BPMs have in common, as motion of the beam that is new at
            every row, shape (n, n) [m²]; None: there is none, and N is the noise of each reading
            alone.
        colour: What ln r changes from one octave of frequency to the next slower one, shape (K,);
            all zero: a walk.
    """

    walk: Matrix
    white: Matrix
    shaken: Matrix | None = None
    colour: Vector = field(default_factory=lambda: np.zeros(OCTAVES))
    modes: Matrix = field(init=False)
    """W, shape (n, n) [1/m]."""
    ratio: Vector = field(init=False)
    """q, shape (n,)."""
    log_white: float = field(init=False)
    """ln |N|."""

    def __post_init__(self) -> None:
        try:
            ratio, modes = eigh(self.walk, self.white)
        except np.linalg.LinAlgError as error:
            raise EstimationError(
                "the noise of the readings cannot be estimated: its covariance is singular; "
                "leave out BPMs that read the same at every row, or give a longer record"
            ) from error
        object.__setattr__(self, "ratio", np.maximum(ratio, 0.0))
        object.__setattr__(self, "modes", modes)
        object.__setattr__(self, "log_white", float(np.linalg.slogdet(self.white)[1]))

    @property
    def reading(self) -> Vector:
        """Variance of the noise of each reading alone, shape (n,) [m²]."""
        white = np.diag(self.white)
        return white.copy() if self.shaken is None else white - np.diag(self.shaken)

    def improved(self, walk: Matrix, reading: Vector) -> "StepNoise":
        """The same with another walk and other noise of the readings; what shakes stays."""
        white = np.diag(reading)
        return replace(self, walk=walk, white=white if self.shaken is None else white + self.shaken)

    def variance(self, transform: StepTransform) -> Matrix:
        """Variance of every mode at every frequency, shape (T, n)."""
        return self.variance_at(transform.eigenvalue)

    def variance_at(self, eigenvalue: Vector) -> Matrix:
        """Variance of every mode at some λ, shape (F, n)."""
        return np.outer(self.reddened(eigenvalue), self.ratio) + eigenvalue[:, None]

    def reddened(self, eigenvalue: Vector) -> Vector:
        """Factor of the walk at some λ, same shape."""
        return np.exp(ramps(eigenvalue) @ self.colour)

    def recoloured(self, spectrum: Matrix, transform: StepTransform) -> tuple[float, "StepNoise"]:
        """Fit how much the walk has in every octave of frequency, beside its orbits.

        Args:
            spectrum: Transformed steps that are walk and noise, shape (T, n) [m].
            transform: Of the record.

        Returns:
            Factor by which the walk is larger besides [1], and the same with the other colour.
        """
        level, colour = changed(
            self.ratio, (spectrum @ self.modes) ** 2, transform.eigenvalue, self.colour
        )
        return level, replace(self, colour=colour)

    def pull(self, spectrum: Matrix, transform: StepTransform) -> Matrix:
        """Ω_f z_f of a spectrum z, Ω = (Q + λN)⁻¹, shape (T, n) [1/m]."""
        return ((spectrum @ self.modes) / self.variance(transform)) @ self.modes.T

    def pull_by_band(self, spectrum: Matrix, transform: StepTransform) -> Matrix:
        """The same with the mean weight of every band, as information is summed, (T, n) [1/m]."""
        weight = self.inverse_variance(transform)[transform.band]
        return ((spectrum @ self.modes) * weight) @ self.modes.T

    def log_likelihood(self, spectrum: Matrix, transform: StepTransform) -> float:
        """Log density of transformed steps, shape (T, n)."""
        variance = self.variance(transform)
        square = float(np.sum((spectrum @ self.modes) ** 2 / variance))
        log_det = float(np.sum(np.log(variance))) + len(transform) * self.log_white
        return -0.5 * (square + log_det + spectrum.size * np.log(2.0 * np.pi))

    def precision(self, transform: StepTransform, patterns: Matrix) -> Matrix:
        """Pᵀ Ω_b P of every band, shape (B, k, k)."""
        seen = patterns.T @ self.modes
        mean = self.inverse_variance(transform)
        return np.stack([(seen * weight) @ seen.T for weight in mean])

    def inverse_variance(self, transform: StepTransform) -> Matrix:
        """Mean of 1/(q + λ) of every mode over every band, shape (B, n)."""
        return transform.by_band(1.0 / self.variance(transform)) / transform.count[:, None]

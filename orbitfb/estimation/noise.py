"""Covariance of the steps of readings: a walk, and noise that comes and goes."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import eigh

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.estimation.colour import changed, choice, ramps
from orbitfb.estimation.priors import OCTAVES
from orbitfb.estimation.transform import Indices, Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class StepNoise:
    """Walk covariance Q and noise covariance N of n readings, and the modes that part them.

    W solves Wᵀ N W = 1, Wᵀ Q W = diag(q): in the modes z W the covariance of a step of frequency f
    is diag(q + λ_f). Where the ground does not walk but goes on as before, springs back or drifts
    it is diag(q r_f + λ_f). The logarithm of r is zero on average over all frequencies, and changes
    from one octave to the next (`colour`); each plane has an r of its own.

    Args:
        walk: Q, shape (n, n) [m²].
        white: N, shape (n, n) [m²], positive definite.
        shaken: Part of N that several BPMs have in common, as motion of the beam that is new at
            every row, shape (n, n) [m²]; None: there is none, and N is the noise of each reading
            alone.
        colour: What ln r changes from one octave of frequency to the next slower one, of every
            plane, shape (P, K); all zero: a walk.
        plane: Number of that of every reading, shape (n,); empty: all have one.
    """

    walk: Matrix
    white: Matrix
    shaken: Matrix | None = None
    colour: Matrix = field(default_factory=lambda: np.zeros((1, OCTAVES)))
    plane: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
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
        if not len(self.plane):
            object.__setattr__(self, "plane", np.zeros(len(ratio), dtype=np.intp))
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
        return self.reddened(eigenvalue) * self.ratio + eigenvalue[:, None]

    def reddened(self, eigenvalue: Vector) -> Matrix:
        """Factor of the walk at some λ, of every mode, shape (F, n)."""
        return np.exp(ramps(eigenvalue) @ self.colour[self.mode_plane()].T)

    def mode_plane(self) -> Indices:
        """Number of the plane of every mode, shape (n,): of those readings that have most of it."""
        share = np.diag(self.white)[:, None] * self.modes**2
        planes = range(len(self.colour))
        return np.argmax([share[self.plane == one].sum(axis=0) for one in planes], axis=0)

    def recoloured(self, spectrum: Matrix, transform: StepTransform) -> tuple[Vector, "StepNoise"]:
        """Fit how much the walk has in every octave of frequency, beside its orbits.

        Args:
            spectrum: Transformed steps that are walk and noise, shape (T, n) [m].
            transform: Of the record.

        Returns:
            Factor by which the walk of every reading is larger besides, shape (n,) [1], and the
            same with the other colour.
        """
        square, plane = (spectrum @ self.modes) ** 2, self.mode_plane()
        fits = [
            changed(self.ratio[plane == one], square[:, plane == one], transform.eigenvalue, its)
            for one, its in enumerate(self.colour)
        ]
        levels, colours = zip(*fits, strict=True)
        return np.array(levels)[self.plane], replace(self, colour=np.stack(colours))

    def choice_of_colour(self, transform: StepTransform) -> float:
        """What is lost by having fitted it [nats]."""
        plane = self.mode_plane()
        return sum(
            choice(self.ratio[plane == one], transform.eigenvalue, its)
            for one, its in enumerate(self.colour)
        )

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

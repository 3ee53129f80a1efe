"""The noise-aware law: full gain against a distorted orbit, the Kalman gain at the noise floor.

    a = −K U f(Uᵀ e),     f_i(z) = z − (1 − L_i) δ_i tanh(z / δ_i)

U are the left singular vectors of the response (modes of the orbit), K its regularised inverse
(`policies.inverse`). Far from zero, |z| ≫ δ_i, the gain of a mode is 1 and one change corrects
it; near zero it is L_i, so that reading noise is averaged and not written to the beam. δ_i → ∞
leaves the linear law with gains L_i, the strong linear baseline; δ_i = 0 has gain 1 throughout.

For a mode that moves by a random step of variance q² per tick and is read with noise of
variance r² no law of any memory does better at rest than the constant gain

    L = M / (M + r²),   M = r² (ρ² + ρ √(ρ² + 4)) / 2,   ρ = q / r,

with M the variance of the predicted orbit: the stationary Kalman filter, and because a change
moves the orbit at once, also the LQG law without a cost of changes.

Where R is ill-conditioned, K is damped by λ or by the doubt about R, and the gain of a weak mode at
rest, L times what the damping leaves, may be so small that a slow creep of the orbit grows large
in it. At the floor a mistake costs little, for changes are small there. So there K_near may stand
for K, damped by a share of λ² and of the doubt:

    a = −K U z + (K − K_near L) U δ tanh(z / δ),    z = Uᵀ e.

By default q_i² of mode i is g² σ_i² / mean(σ²): kicks at many places along the ring reach the
modes as the correctors do. On the default ring that is within a factor 2 of what moving
quadrupoles make in the modes that count.

Source: Kalman filter in steady state, e.g. Anderson and Moore, Optimal Filtering, ch. 4.
"""

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.blocks import Plane, PlaneDamping, damping_of
from orbitfb.policies.infill import NOISY, Infill
from orbitfb.policies.inverse import (
    checked_covariance,
    checked_response,
    content_hash,
    frozen,
    regularised_inverse,
)

_ORTHONORMAL = 1e-6


class ModalSettings(Settings):
    """Configuration of the noise-aware law."""

    regularisation: float = Field(
        default=0.0, ge=0.0, description="Tikhonov λ, compared with the singular values [m/A]."
    )
    planes: dict[Plane, PlaneDamping] = Field(
        default={},
        description="λ of each plane by itself, tables `planes.x` and `planes.y`; none: one for "
        "all correctors.",
    )
    reading_noise: float = Field(
        default=0.2e-6, gt=0.0, description="BPM noise that the gains are made for, rms [m]."
    )
    ground: float = Field(
        default=0.04e-6,
        ge=0.0,
        description="Motion of the orbit per tick that the gains are made for, rms [m].",
    )
    minimum_gain: float = Field(
        default=0.02, gt=0.0, le=1.0, description="Smallest gain of a mode at the noise floor [1]."
    )
    near_caution: float = Field(
        default=1.0,
        gt=0.0,
        le=1.0,
        description="Share of λ² and of the doubt about R̂ that counts at the noise floor [1].",
    )
    threshold: float | None = Field(
        default=5.0,
        ge=0.0,
        description="Where a mode goes over to full gain, in units of reading_noise [1]; "
        "unset: never, the law is linear.",
    )


class ModalPolicy:
    """Correct every mode with the gain that its signal and its noise call for.

    Masked BPMs read what the valid ones let expect (`policies.infill`). There is no state, and the
    tensors are copied and read-only, so a policy can be shared between threads.

    Args:
        response: R, shape (n, m) [m/A].
        settings: Regularisation, and the noise that default gains are made from.
        modes: U, orthonormal, shape (n, n); None: the left singular vectors of R.
        gains: L, shape (n,) or one for all, in (0, 1] [1]; None: from the settings.
        thresholds: δ, shape (n,) or one for all [m]; inf and 0 are allowed; None: from the
            settings.
        covariance: Covariance P of every row of R, shape (m, m) [(m/A)²]; None: R is exact.
        policy_id: Its name; by default `modal-` and a hash of the content.

    Attributes:
        response, modes, gains, thresholds, covariance, settings: As given or made.
        damping: λ of each corrector, shape (m,) [m/A].
        inverse: K, shape (m, n) [A/m].
        near_inverse: K_near, shape (m, n) [A/m].
        gain_matrix: Slope at zero, K_near U diag(L) Uᵀ, shape (m, n) [A/m].

    Raises:
        RingError: A matrix is not finite, has the wrong shape, or modes are not orthonormal.
        ConfigError: Gains or thresholds out of their range.
    """

    def __init__(
        self,
        response: Vector,
        settings: ModalSettings,
        modes: Vector | None = None,
        gains: Vector | float | None = None,
        thresholds: Vector | float | None = None,
        covariance: Vector | None = None,
        policy_id: str | None = None,
    ) -> None:
        self.response = checked_response(response)
        n, m = self.response.shape
        self.settings = settings
        self.covariance = None if covariance is None else checked_covariance(covariance, m)
        self.modes = frozen(left_modes(self.response) if modes is None else _checked(modes, n))
        chosen = default_gains(self.response, self.modes, settings) if gains is None else gains
        self.gains = _per_mode(chosen, n, "gains", 1.0)
        if thresholds is None:
            units = np.inf if settings.threshold is None else settings.threshold
            thresholds = units * settings.reading_noise
        self.thresholds = _per_mode(thresholds, n, "thresholds", np.inf)
        self._policy_id = policy_id or "modal-" + content_hash(
            settings,
            self.response,
            self.modes,
            self.gains,
            self.thresholds,
            self.covariance,
            exclude=() if settings.planes else ("planes",),  # the names of old laws stay
        )
        self.damping = frozen(damping_of(settings.planes, settings.regularisation, m))
        self.inverse = regularised_inverse(self.response, self.damping, self.covariance)
        self.near_inverse = self._near_inverse()
        two_scales = self.near_inverse is not self.inverse
        # In units of its threshold, y = z / δ, a bent mode is δ (y − (1 − L) tanh y): the units
        # go into the matrices on both sides, and a mode that is linear all over is one of them.
        bent = np.isfinite(self.thresholds) & (self.thresholds > 0.0)
        bent &= (self.gains < 1.0) | two_scales
        units = np.where(bent, self.thresholds, settings.reading_noise)
        far, near = self.inverse @ self.modes, self.near_inverse @ self.modes * self.gains
        slopes = np.where(self.thresholds == 0.0, far, near)
        outward = np.where(np.isinf(self.thresholds), near, far)
        self._inward = frozen(self.modes.T / units[:, None])
        self._outward = frozen(-outward * units)
        self._bend = frozen(np.where(bent, 1.0 - self.gains, 0.0))
        self._back = frozen(np.where(bent, far - near, 0.0) * units) if two_scales else None
        self._linear = not bent.any()
        self.gain_matrix = frozen(slopes @ self.modes.T)
        self._infill = Infill(self.response, NOISY)

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it."""
        return self._policy_id

    def initial_state(self) -> None:
        """There is no state."""
        return

    def act(self, error: Vector, valid: Mask, state: None) -> tuple[Vector, None]:
        """Decide.

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: None.

        Returns:
            The change of setpoints, shape (m,) [A], and no state.
        """
        if np.count_nonzero(valid) == len(valid):  # a third of the time of valid.all()
            return self._change(error), None
        filled = self._infill.fill(error, valid)
        return self._infill.least(self._change(filled), valid), None

    def _change(self, error: Vector) -> Vector:
        """Decide with every BPM, shape (m,) [A]."""
        if self._linear:
            return -self.gain_matrix.dot(error)
        amplitudes = self._inward.dot(error)
        bent = np.tanh(amplitudes)
        if self._back is not None:
            return self._outward.dot(amplitudes) + self._back.dot(bent)
        amplitudes -= self._bend * bent
        return self._outward.dot(amplitudes)

    def changes(self, errors: Vector) -> Vector:
        """Decide on many orbits at once, all BPMs valid.

        Args:
            errors: Orbit − reference, shape (..., n) [m].

        Returns:
            The changes of setpoints, shape (..., m) [A].
        """
        if self._linear:
            return -(errors @ self.gain_matrix.T)
        amplitudes = errors @ self._inward.T
        bent = np.tanh(amplitudes)
        if self._back is not None:
            return amplitudes @ self._outward.T + bent @ self._back.T
        amplitudes -= self._bend * bent
        return amplitudes @ self._outward.T

    def _near_inverse(self) -> Vector:
        share, strength = self.settings.near_caution, self.damping
        if share == 1.0 or (not strength.any() and self.covariance is None):
            return self.inverse
        doubt = None if self.covariance is None else share * self.covariance
        return regularised_inverse(self.response, np.sqrt(share) * strength, doubt)


def left_modes(response: Vector) -> Vector:
    """Give a whole orthonormal base of orbits, the left singular vectors, shape (n, n)."""
    return np.linalg.svd(response, full_matrices=True)[0]


def default_gains(response: Vector, modes: Vector, settings: ModalSettings) -> Vector:
    """Give every mode its Kalman gain when kicks all along the ring move the orbit.

    Args:
        response: R, shape (n, m) [m/A].
        modes: U, shape (n, n).
        settings: Reading noise, ground, smallest gain.

    Returns:
        L, shape (n,) [1].
    """
    power = np.sum((modes.T @ response) ** 2, axis=1)
    steps = settings.ground**2 * power / np.mean(power)
    return np.maximum(kalman_gain(steps, settings.reading_noise**2), settings.minimum_gain)


def kalman_gain(step_variance: Vector | float, reading_variance: float) -> Vector:
    """Give the stationary Kalman gain of a random walk that is read with white noise.

    Args:
        step_variance: q² per tick of every mode, shape (n,) or a number [m²].
        reading_variance: r² [m²], above 0.

    Returns:
        L = M / (M + r²), same shape [1].
    """
    ratio = np.asarray(step_variance, dtype=np.float64) / reading_variance
    predicted = 0.5 * (ratio + np.sqrt(ratio * (ratio + 4.0)))
    return predicted / (predicted + 1.0)


def _checked(modes: Vector, n: int) -> Vector:
    matrix = np.asarray(modes, dtype=np.float64)
    if matrix.shape != (n, n):
        raise RingError(
            f"the modes have shape {matrix.shape}; with {n} BPMs they must be ({n}, {n})"
        )
    defect = np.max(np.abs(matrix.T @ matrix - np.eye(n)))
    if not defect <= _ORTHONORMAL:
        raise RingError(
            f"the modes are not orthonormal (defect {defect:.2g}); use the left singular vectors "
            "of a response matrix"
        )
    return matrix


def _per_mode(values: Vector | float, n: int, name: str, largest: float) -> Vector:
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape not in ((), (n,)):
        raise RingError(f"{name} have shape {vector.shape}; give one for each of {n} modes")
    if not (np.all(vector >= 0.0) and np.all(vector <= largest)):
        raise ConfigError(
            f"{name} lie between {np.min(vector):g} and {np.max(vector):g}; they must lie between "
            f"0 and {largest:g}"
        )
    return frozen(np.broadcast_to(vector, (n,)))

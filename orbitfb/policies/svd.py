"""The baseline: correction through the singular value decomposition of the response matrix.

With R = U Σ Vᵀ (rows BPMs, columns correctors, [m/A]) the change of the setpoints is

    a = −gain · V diag(σ / (σ² + λ²)) Uᵀ e

over the first `singular_values` modes. The setpoints accumulate the changes, so this
proportional law leaves a constant error only behind a disturbance that keeps moving; the
integral term (PI in mode space) takes that away as well.

With a covariance P of the rows of R [(m/A)²] the law becomes *cautious*: it minimises the
expected square of the next orbit over what is not known about R,

    K = gain · (RᵀR + λ² I + n P)⁻¹ Rᵀ,

solved within the modes that are kept, so that P = 0 gives the law above exactly.
"""

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.inverse import (
    checked_covariance,
    checked_response,
    content_hash,
    frozen,
    regularised_inverse,
)
from orbitfb.policies.recent import Recent


class SvdSettings(Settings):
    """Configuration of the SVD policy."""

    gain: float = Field(
        default=0.5,
        gt=0.0,
        le=2.0,
        description="Proportional gain: share of the error per tick [1].",
    )
    regularisation: float = Field(
        default=70e-6, ge=0.0, description="Tikhonov λ, compared with the singular values [m/A]."
    )
    singular_values: int | None = Field(
        default=None,
        ge=1,
        description="Number of modes that are corrected [1]; unset: all of them.",
    )
    integral_gain: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="Gain of the summed error per tick [1]; 0: no integral.",
    )
    integral_limit: float = Field(
        default=0.01, gt=0.0, description="Largest rms of the integral's share of one change [A]."
    )


class SvdPolicy:
    """Correct the orbit error through the (regularised) inverse of a response matrix.

    Masked BPMs are taken out of the equations: the law for the remaining rows is solved when
    a mask is first seen, and the last few are kept. The tensors are copied and read-only, so
    a policy can be shared between threads.

    Args:
        response: R, shape (n, m) [m/A].
        settings: Gains and regularisation.
        policy_id: Its name; by default `svd-` and a hash of the content.
        covariance: Covariance P of every row of R, shape (m, m) [(m/A)²]; None: R is exact.

    Attributes:
        response: R, shape (n, m) [m/A].
        covariance: P, shape (m, m) [(m/A)²], or None.
        settings: Gains and regularisation.
        gain_matrix: K, shape (m, n) [A/m]: the proportional law is a = −K e.

    Raises:
        RingError: A matrix is not finite or has the wrong shape.
        ConfigError: More singular values are asked for than there are.
    """

    def __init__(
        self,
        response: Vector,
        settings: SvdSettings,
        policy_id: str | None = None,
        covariance: Vector | None = None,
    ) -> None:
        self.response = checked_response(response)
        columns = self.response.shape[1]
        self.covariance = None if covariance is None else checked_covariance(covariance, columns)
        self.settings = settings
        modes = min(self.response.shape)
        if settings.singular_values is not None and settings.singular_values > modes:
            raise ConfigError(
                f"singular_values is {settings.singular_values}, but a response matrix of shape "
                f"{self.response.shape} has only {modes}; lower it or leave it unset"
            )
        self._policy_id = policy_id or "svd-" + content_hash(
            settings, self.response, self.covariance
        )
        self.gain_matrix = self._solve(self.response)
        self._integral_ratio = settings.integral_gain / settings.gain
        self._masked = Recent(lambda valid: self._solve(self.response[valid]))

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it."""
        return self._policy_id

    def initial_state(self) -> Vector:
        """Begin without an integral: zeros of shape (m,) [A]."""
        return np.zeros(self.response.shape[1])

    def act(self, error: Vector, valid: Mask, state: Vector) -> tuple[Vector, Vector]:
        """Decide.

        The state is the integral's share of the change, kept at the correctors and not in the
        modes: all modes have one gain, so it is the same sum, and it keeps its meaning when a
        mask changes the modes. Its rms is limited, and it is handed in and out, so a caller
        whose change was shortened or not written hands the old state in again and nothing
        winds up.

        A mask that is new costs one decomposition (about 5 ms for 180 by 180).

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: Integral's share of the last change, shape (m,) [A].

        Returns:
            The change of setpoints, shape (m,) [A], and the new state.
        """
        if valid.all():
            proportional = self.gain_matrix @ error
        else:
            proportional = self._masked.get(valid) @ error[valid]
        if self._integral_ratio == 0.0:
            return -proportional, state
        integral = state + self._integral_ratio * proportional
        rms = float(np.sqrt(np.mean(integral**2)))
        if rms > self.settings.integral_limit:
            integral *= self.settings.integral_limit / rms
        return -(proportional + integral), integral

    def changes(self, errors: Vector) -> Vector:
        """Decide on many orbits at once, all BPMs valid, by the proportional law.

        Args:
            errors: Orbit − reference, shape (..., n) [m].

        Returns:
            The changes of setpoints, shape (..., m) [A].

        Raises:
            ConfigError: The law has an integral: what it does depends on what was before.
        """
        if self._integral_ratio != 0.0:
            raise ConfigError(
                f"policy {self._policy_id} has integral_gain "
                f"{self.settings.integral_gain:g}, so its changes depend on the orbits before; "
                "ask act tick by tick, or set it to 0"
            )
        return -(errors @ self.gain_matrix.T)

    def _solve(self, response: Vector) -> Vector:
        """Invert a response matrix, shape (rows, m), into K, shape (m, rows)."""
        settings = self.settings
        inverse = regularised_inverse(
            response, settings.regularisation, self.covariance, settings.singular_values
        )
        return frozen(settings.gain * inverse)

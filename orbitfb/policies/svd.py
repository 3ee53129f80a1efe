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

import hashlib
import threading
from collections import OrderedDict

import numpy as np
from pydantic import Field

from orbitfb.core.errors import ConfigError, RingError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Mask, Vector

_MASKS_KEPT = 8
_SMALLEST = np.finfo(np.float64).eps


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
        self.response = _checked_response(response)
        self.covariance = None if covariance is None else _checked(covariance, self.response)
        self.settings = settings
        modes = min(self.response.shape)
        if settings.singular_values is not None and settings.singular_values > modes:
            raise ConfigError(
                f"singular_values is {settings.singular_values}, but a response matrix of shape "
                f"{self.response.shape} has only {modes}; lower it or leave it unset"
            )
        self._policy_id = policy_id or "svd-" + _content_hash(
            self.response, self.covariance, settings
        )
        self.gain_matrix = self._solve(self.response)
        self._integral_ratio = settings.integral_gain / settings.gain
        self._masked: OrderedDict[bytes, Vector] = OrderedDict()
        self._lock = threading.Lock()

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
            proportional = self._gain_for(valid) @ error[valid]
        if self._integral_ratio == 0.0:
            return -proportional, state
        integral = state + self._integral_ratio * proportional
        rms = float(np.sqrt(np.mean(integral**2)))
        if rms > self.settings.integral_limit:
            integral *= self.settings.integral_limit / rms
        return -(proportional + integral), integral

    def _gain_for(self, valid: Mask) -> Vector:
        """Give K for the valid rows alone, shape (m, valid.sum()) [A/m]."""
        key = valid.tobytes()
        with self._lock:
            gain = self._masked.get(key)
            if gain is not None:
                self._masked.move_to_end(key)
                return gain
        gain = self._solve(self.response[valid])
        with self._lock:
            self._masked[key] = gain
            while len(self._masked) > _MASKS_KEPT:
                self._masked.popitem(last=False)
        return gain

    def _solve(self, response: Vector) -> Vector:
        """Invert a response matrix, shape (rows, m), into K, shape (m, rows)."""
        rows, columns = response.shape
        if rows == 0:
            return np.zeros((columns, 0))
        u, sigma, vt = np.linalg.svd(response, full_matrices=False)
        kept = int(np.sum(sigma > _SMALLEST * max(rows, columns) * sigma[0]))
        if self.settings.singular_values is not None:
            kept = min(kept, self.settings.singular_values)
        u, sigma, vt = u[:, :kept], sigma[:kept], vt[:kept]
        damping = sigma**2 + self.settings.regularisation**2
        if self.covariance is None:
            inverse = (vt.T * (sigma / damping)) @ u.T
        else:
            doubt = rows * (vt @ self.covariance @ vt.T)
            inverse = vt.T @ np.linalg.solve(np.diag(damping) + doubt, sigma[:, None] * u.T)
        return _frozen(self.settings.gain * inverse)


def _frozen(matrix: Vector) -> Vector:
    """Copy into contiguous memory that nobody can write."""
    copy = np.array(matrix, dtype=np.float64, order="C")
    copy.setflags(write=False)
    return copy


def _checked_response(response: Vector) -> Vector:
    matrix = np.asarray(response)
    if matrix.ndim != 2 or 0 in matrix.shape:
        raise RingError(
            f"the response matrix has shape {matrix.shape}; a policy needs (BPMs, correctors)"
        )
    if not np.issubdtype(matrix.dtype, np.floating):
        raise RingError(f"the response matrix is of {matrix.dtype}; real numbers [m/A] are needed")
    finite = np.isfinite(matrix)
    if not finite.all():
        row, column = np.argwhere(~finite)[0]
        raise RingError(
            f"{np.sum(~finite)} elements of the response matrix are not finite, the first in row "
            f"{row} (BPM), column {column} (corrector); measure or compute it again"
        )
    if not np.any(matrix):
        raise RingError("the response matrix is all zeros; measure or compute it again")
    return _frozen(matrix)


def _checked(covariance: Vector, response: Vector) -> Vector:
    matrix = np.asarray(covariance, dtype=np.float64)
    columns = response.shape[1]
    if matrix.shape != (columns, columns):
        raise RingError(
            f"the covariance has shape {matrix.shape}; with {columns} correctors it must be "
            f"({columns}, {columns})"
        )
    if not np.isfinite(matrix).all():
        raise RingError("the covariance of the response matrix is not finite; refit it")
    scale = float(np.max(np.abs(matrix)))
    if not np.allclose(matrix, matrix.T, rtol=0.0, atol=1e-9 * scale) or np.any(
        np.diag(matrix) < 0.0
    ):
        raise RingError("the covariance of the response matrix is no covariance; refit it")
    return _frozen(0.5 * (matrix + matrix.T))


def _content_hash(response: Vector, covariance: Vector | None, settings: SvdSettings) -> str:
    digest = hashlib.sha256(settings.model_dump_json().encode())
    digest.update(repr(response.shape).encode())
    digest.update(response.astype("<f8").tobytes())
    if covariance is not None:
        digest.update(covariance.astype("<f8").tobytes())
    return digest.hexdigest()[:12]

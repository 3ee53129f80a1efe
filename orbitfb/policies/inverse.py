"""What the linear parts of all laws share: the regularised inverse of a response matrix.

The change a = −K e with

    K = (RᵀR + λ² I + n P)⁻¹ Rᵀ

minimises the expected |e + R a|² + λ² |a|² over what is not known about R, when the rows of R
(n of them) are independent with covariance P [(m/A)²] around their mean. P = 0 is Tikhonov's
inverse; a large P in a direction keeps the law from acting there.
"""

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RingError
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector

_SMALLEST = np.finfo(np.float64).eps
_WORST_PIVOT = 1e-5
"""Ratio of Cholesky pivots below which the squared equations are not trusted; its square is
about the inverse of their condition number, so that at least 5 digits remain."""


def regularised_inverse(
    response: Vector,
    regularisation: float | Vector,
    covariance: Vector | None = None,
    singular_values: int | None = None,
) -> Vector:
    """Invert a response matrix, within its first modes.

    Args:
        response: R, shape (n, m) [m/A]; n may be 0.
        regularisation: λ [m/A], or one for each corrector, shape (m,), without a cut.
        covariance: P of every row of R, shape (m, m) [(m/A)²]; None: R is exact.
        singular_values: How many modes are kept; None: all that are not lost to rounding.

    Returns:
        K, shape (m, n) [A/m], read-only.
    """
    rows, columns = response.shape
    if rows == 0:
        return frozen(np.zeros((columns, 0)))
    if isinstance(regularisation, np.ndarray):
        if np.ptp(regularisation) > 0.0:
            return _damped_by_corrector(response, regularisation, covariance)
        regularisation = float(regularisation[0])
    if covariance is not None and singular_values is None:
        quick = _cautious(response, regularisation, covariance)
        if quick is not None:
            return quick
    u, sigma, vt = np.linalg.svd(response, full_matrices=False)
    kept = int(np.sum(sigma > _SMALLEST * max(rows, columns) * sigma[0]))
    if singular_values is not None:
        kept = min(kept, singular_values)
    u, sigma, vt = u[:, :kept], sigma[:kept], vt[:kept]
    damping = sigma**2 + regularisation**2
    if covariance is None:
        return frozen((vt.T * (sigma / damping)) @ u.T)
    doubt = rows * (vt @ covariance @ vt.T)
    return frozen(vt.T @ np.linalg.solve(np.diag(damping) + doubt, sigma[:, None] * u.T))


def _damped_by_corrector(response: Vector, damping: Vector, covariance: Vector | None) -> Vector:
    """Solve as least squares of R, λ of each corrector and a root of n P below each other."""
    rows = len(response)
    below = [np.diag(damping)]
    if covariance is not None:
        values, vectors = np.linalg.eigh(rows * covariance)
        below.append(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)
    stacked = np.vstack([response, *below])
    whole = np.linalg.pinv(stacked, rcond=float(_SMALLEST) * max(stacked.shape))
    return frozen(np.asarray(whole[:, :rows], dtype=np.float64))


def _cautious(response: Vector, regularisation: float, covariance: Vector) -> Vector | None:
    """Solve the equations as they stand, much faster than by modes; None if badly conditioned."""
    rows, columns = response.shape
    damped = response.T @ response + rows * covariance
    damped.flat[:: columns + 1] += regularisation**2
    try:
        diagonal = np.diag(np.linalg.cholesky(damped))
    except np.linalg.LinAlgError:
        return None
    if np.min(diagonal) < _WORST_PIVOT * np.max(diagonal):
        return None
    return frozen(np.linalg.solve(damped, response.T))


def frozen(matrix: Vector) -> Vector:
    """Copy into contiguous memory that nobody can write."""
    copy = np.array(matrix, dtype=np.float64, order="C")
    copy.setflags(write=False)
    return copy


def checked_response(response: Vector) -> Vector:
    """Return a read-only copy of a response matrix, shape (n, m) [m/A].

    Raises:
        RingError: It is no matrix of finite real numbers, or all zeros.
    """
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
    return frozen(matrix)


def checked_covariance(covariance: Vector, columns: int) -> Vector:
    """Return a read-only copy of the covariance of a response's rows, shape (m, m) [(m/A)²].

    Args:
        covariance: What to check.
        columns: Number of correctors m.

    Raises:
        RingError: It has another shape or is no covariance.
    """
    matrix = np.asarray(covariance, dtype=np.float64)
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
    return frozen(0.5 * (matrix + matrix.T))


def content_hash(
    settings: Settings, *tensors: NDArray[np.floating[Any]] | None, exclude: Sequence[str] = ()
) -> str:
    """Name a policy by its content: 12 hexadecimal digits of its settings and tensors.

    Args:
        settings: Of the law.
        tensors: Of the law.
        exclude: Settings that have no part in the name.
    """
    digest = hashlib.sha256(settings.model_dump_json(exclude={*exclude}).encode())
    for tensor in tensors:
        if tensor is None:
            digest.update(b"none")
            continue
        digest.update(repr((tensor.dtype.str, tensor.shape)).encode())
        digest.update(np.ascontiguousarray(tensor).tobytes())
    return digest.hexdigest()[:12]

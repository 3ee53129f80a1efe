"""The law of the loop of a record, as far as it is a linear one."""

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_FOLLOWS = 0.98
"""Share of the variance of the requested changes that a linear law must explain."""
_RIDGE = 1e-8


def linear_law(record: Record, other: Record | None = None) -> tuple[Matrix | None, float]:
    """Estimate K of change = −K (orbit − reference) + dither.

    Args:
        record: Whose law is in question.
        other: A longer record, perhaps of the same law: it is asked where the first one is too
            short, and must explain the changes of the first one.

    Returns:
        K, shape (m, n) [A/m], None when changes do not follow such a law; and the share of
        their variance that it explains, on ticks that it was not fitted to; NaN when there are
        too few ticks to tell.
    """
    known, change, error = _law_of(record)
    fitted = known & ((np.arange(len(record)) // 10) % 2 == 0)
    judged = known & ~fitted
    if fitted.sum() > error.shape[1]:
        follows = _share(_ridge(error[fitted], change[fitted]), error[judged], change[judged])
        law = _ridge(error[known], change[known])
    elif other is not None and other is not record:
        found, its_share = linear_law(other)
        if found is None:
            return None, its_share
        law, follows = found, _share(found, error[known], change[known])
    else:
        return None, np.nan
    return (law if follows >= _FOLLOWS else None), max(follows, 0.0)


def reference_of(record: Record) -> Matrix:
    """Reference orbit of every row, zero where none was recorded, shape (N, n) [m]."""
    return np.zeros_like(record.readings) if record.reference is None else record.reference


def _law_of(record: Record) -> tuple[Mask, Matrix, Matrix]:
    """Rows that tell something, changes without the dither [A], orbit errors [m]."""
    known: Mask = np.all(np.isfinite(record.requested), axis=1)
    change = record.requested - (0.0 if record.dither is None else record.dither)
    return known, change, record.readings - reference_of(record)


def _share(law: Matrix, error: Matrix, change: Matrix) -> float:
    """Share of the variance of changes that a law explains."""
    size = float(np.sum(change**2))
    return 1.0 - float(np.sum((change + error @ law.T) ** 2)) / size if size > 0.0 else 0.0


def _ridge(error: Matrix, change: Matrix) -> Matrix:
    normal = error.T @ error
    normal[np.diag_indices_from(normal)] += _RIDGE * np.trace(normal) / len(normal)
    return -np.linalg.solve(normal, error.T @ change).T.astype(np.float64)

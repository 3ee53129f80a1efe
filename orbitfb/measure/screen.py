"""What is seen before any fit: dead devices, exchanged ones, another order, plane or direction."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

DEAD = 0.1
"""Share of what the optics say below which a device is dead; measured rings have 0.3 to 2."""

_ALIKE = 0.5
"""Least cosine of two responses of one ring [1]."""

SIGN = 0.85
"""Least size of a negative cosine that is a matter of the sign alone [1]: names that are shifted by
one have −0.6, measured responses of the right order 0.9 and more."""

MOST_SIZE = 3.0
"""How many times larger or smaller than by the optics a response may be [1]; the calibrations of
whole rings are off by 2 at most, wrong units by 1000."""

_OTHER_UNIT = 10.0
"""The same for a response that is fitted: near an integer tune it grows by a few, which a fit
finds, and units differ by 1000 [1]."""

_LEAST_GAIN = 0.5
"""An exchange must leave less than this share of the misfit of both rows [1]."""

_MISFIT = 4.0
"""Times the median misfit from which a row may be an exchanged one [1]."""


_NOTHING = 1e-4
"""Misfit below which a row fits whatever the others do: 1 % of its size [1]."""


@dataclass(frozen=True, slots=True)
class Order:
    """How the rows (or columns) of a matrix stand to those of the optics.

    Args:
        shift: Rows by which the matrix is moved; 0: none.
        reversed: Whether they stand in the opposite order.
        cosine: With the optics, once moved [1].
    """

    shift: int
    reversed: bool
    cosine: float


def cosine(data: Matrix, model: Matrix) -> float:
    """Cosine of two matrices over what was measured [1]."""
    there = np.isfinite(data)
    a, b = data[there], model[there]
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0 else 0.0


def row_sizes(data: Matrix, model: Matrix) -> Vector:
    """Size of every row over that of the optics; NaN: not measured.

    By the medians of the sizes: one column of another size does not change the rows.
    """
    there = np.isfinite(data) & (model != 0.0)  # of the other plane the optics say nothing
    measured = there.any(axis=1)
    sizes = np.full(len(data), np.nan)
    known = np.where(there, np.abs(data), np.nan)[measured]
    own = np.where(there, np.abs(model), np.nan)[measured]
    sizes[measured] = np.nanmedian(known, axis=1) / np.maximum(np.nanmedian(own, axis=1), 1e-300)
    return sizes


def dead_rows(data: Matrix, model: Matrix) -> Indices:
    """Rows that see less than `DEAD` of what the others see, as indices."""
    sizes = row_sizes(data, model)
    usual = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 1.0
    return np.flatnonzero(sizes < DEAD * usual)


def row_cosines(data: Matrix, model: Matrix) -> Matrix:
    """Cosine of every row with every row of the optics, shape (n, n); 0 where not measured."""
    there = np.isfinite(data)
    known = np.where(there, data, 0.0)
    own = np.sqrt(there.astype(float) @ (model**2).T)
    sizes = np.linalg.norm(known, axis=1)[:, None] * own
    return np.where(sizes > 0, (known @ model.T) / np.maximum(sizes, 1e-300), 0.0)


def exchanges(data: Matrix, model: Matrix) -> list[tuple[int, int]]:
    """Find pairs of rows that stand in each other's place.

    Both fit the other's row of the optics clearly better than their own, best of all, and as well
    as rows usually fit.
    """
    alike = row_cosines(data, model)
    misfit = 1.0 - alike**2
    own = np.diag(misfit).copy()
    measured = np.isfinite(data).any(axis=1)
    if measured.sum() < 2:
        return []
    usual = float(np.median(own[measured]))
    better = np.where(misfit < _LEAST_GAIN * own[:, None], misfit, np.inf)
    np.fill_diagonal(better, np.inf)
    best = np.argmin(better, axis=1)
    found: list[tuple[int, int]] = []
    for row in np.flatnonzero(measured & (own > _MISFIT * usual)).tolist():
        other = int(best[row])
        mutual = int(best[other]) == row and own[other] > _MISFIT * usual
        left = better[[row, other], [other, row]]
        if mutual and row < other and left.max() < max(_MISFIT * usual, _NOTHING):
            found.append((row, other))
    return found


def order_of(data: Matrix, model: Matrix) -> Order:
    """Find the shift of the rows, in either direction, with which they fit the optics best."""
    alike = row_cosines(data, model)
    weight = np.sum(np.where(np.isfinite(data), data, 0.0) ** 2, axis=1)
    weight = weight / max(float(weight.sum()), 1e-300)
    n = len(data)
    rows = np.arange(n)
    best = Order(0, False, float(weight @ np.diag(alike)))
    for backwards in (False, True):
        for shift in range(n):
            to = (-rows - 1 - shift) % n if backwards else (rows - shift) % n
            value = float(weight @ alike[rows, to])
            if abs(value) > abs(best.cosine) + 0.05:
                signed = shift if shift <= n // 2 else shift - n
                best = Order(signed, backwards, value)
    return best


def size_told(data: Matrix, model: Matrix) -> str:
    """Say by how much a matrix is too large or too small as a whole; "" when it is not."""
    sizes = row_sizes(data, model)
    size = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 1.0
    if 1 / _OTHER_UNIT < size < _OTHER_UNIT:
        return ""
    return (
        f"it is {size:.3g} times as large as the optics say: state the unit that it was measured "
        "in (--unit), and see the calibrations of the correctors in the table"
    )


def what_it_looks_like(data: Matrix, model: Matrix, other: Matrix | None) -> str:
    """Say what a matrix is that does not look like the optics; "" when it does.

    Args:
        data: Measured, shape (n, m).
        model: By the optics, shape (n, m).
        other: By the optics in the other plane, if it has that shape.
    """
    found = cosine(evened(data, model), model)
    square = data.shape[0] == data.shape[1]
    as_is, turned = cosine(data, model), cosine(data.T, model) if square else 0.0
    if turned > max(_ALIKE, as_is + 0.1):
        return f"it is transposed (cosine {turned:.2f}, as it stands {as_is:.2f}); give --transpose"
    if found >= _ALIKE:
        return ""
    data = evened(data, model)
    if found <= -SIGN:
        return (
            f"it has the opposite sign of the optics (cosine {found:.2f}); a response is orbit per "
            "setpoint, not the correction: turn its sign where it was made"
        )
    if other is not None and other.shape == data.shape and cosine(data, other) >= _ALIKE:
        return (
            f"it is of the other plane (cosine {cosine(data, other):.2f} with that, {found:.2f} "
            "with its own); exchange the blocks or the planes"
        )
    if told := order_told(data, model):
        return told
    return (
        f"it does not look like the response of this table (cosine {found:.2f}): another ring, "
        "another working point or another order; see --places, --ring and the names"
    )


def evened(data: Matrix, model: Matrix) -> Matrix:
    """Bring all rows and then columns to the size of the optics: one device must not decide."""
    sizes = row_sizes(data, model)
    rows = data / np.where(sizes > 0, sizes, 1.0)[:, None]
    sizes = row_sizes(rows.T, model.T)
    return rows / np.where(sizes > 0, sizes, 1.0)


def order_told(data: Matrix, model: Matrix) -> str:
    """Say by how many rows or columns the names are off; "" when no shift makes it alike."""
    for what, first, second in (("rows", data, model), ("columns", data.T, model.T)):
        order = order_of(first, second)
        if abs(order.cosine) >= _ALIKE and (order.shift or order.reversed):
            kind = "stand in the opposite order" if order.reversed else "are shifted"
            sign = ", with the opposite sign" if order.cosine < 0 else ""
            return (
                f"its {what} {kind} by {order.shift}{sign} (cosine {order.cosine:.2f} with that, "
                f"{cosine(data, model):.2f} as it stands): a line of names too many or too few, or "
                "the beginning of the ring elsewhere; correct the names"
            )
    return ""

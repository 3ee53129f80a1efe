"""From a measured response to its diagnosis: screen, fit, name, and fit again where it helps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.loco.coupling import Coupling, fit_coupling
from orbitfb.loco.estimates import Estimate, estimates
from orbitfb.loco.fit import PlaneFit, row_and_column_gains
from orbitfb.loco.measured import Measured, Pair, bpm_labels, corrector_labels
from orbitfb.loco.named import Named
from orbitfb.loco.names import name_devices
from orbitfb.loco.optics import RingOptics
from orbitfb.loco.parameters import Fit
from orbitfb.loco.together import in_order
from orbitfb.measure.screen import (
    DEAD,
    dead_rows,
    exchanges,
    row_sizes,
    size_told,
    what_it_looks_like,
)
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Ring

_MOST_ROUNDS = 3
"""Fits in a row: each exchange that is seen only after a fit is followed by another one."""


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """What came of it.

    Args:
        ring: The ring.
        measured: As it was given.
        mended: As it was fitted: exchanged devices in their places, dead ones left out.
        optics: The ring at the devices.
        fit: In the planes.
        coupling: Of the cross blocks; None: not measured.
        estimates: Values by group.
        named: Devices that stand out, the surest first, then those that nearly do.
        nominal: Response of the table, by plane [m/rad].
        ladder: Residuals of every step, by plane.
    """

    ring: Ring
    measured: Measured
    mended: Measured
    optics: RingOptics
    fit: Fit
    coupling: Coupling | None
    estimates: dict[str, Estimate]
    named: tuple[Named, ...]
    nominal: dict[Plane, Matrix]
    ladder: dict[Plane, dict[str, float]]


def diagnose(
    ring: Ring,
    measured: Measured,
    progress: Callable[[str, float], None] | None = None,
    model: Mapping[Plane, Matrix] | None = None,
) -> Result:
    """Diagnose a measured response.

    Args:
        ring: The ring.
        measured: The measurement.
        progress: Called with what is done and the share of the work.
        model: Response of every plane by another program, shape (n, m) [m/rad]; None: the table's.

    Raises:
        RingError: It is not of this ring, or the fit has no solution; what it looks like is said.
    """
    tell = progress or (lambda what, share: None)
    if not measured.planes:
        raise RingError("no plane was measured in which BPMs read what correctors of it kick")
    optics = RingOptics(ring, measured, model)
    design = optics.at(np.zeros(len(optics.quadrupoles)))
    nominal: dict[Plane, Matrix] = {plane: its.own for plane, its in design.items()}
    check(measured, nominal)
    mended, named = _mend(ring, measured, nominal)
    fitting, fit = None, None
    for number in range(_MOST_ROUNDS):
        share = number / _MOST_ROUNDS
        fitting = PlaneFit(optics, mended, lambda s, b=share: tell("fitting", b + s / _MOST_ROUNDS))
        fit = fitting.run()
        again, more = _exchanged(ring, mended, fit)
        if not more:
            break
        mended, named = again, named + more
    if fitting is None or fit is None:
        raise RingError("nothing was fitted")
    tell("coupling", 0.9)
    coupling = fit_coupling(optics, mended, fit)
    values = estimates(fitting, fit, coupling)
    found = name_devices(ring, mended, fitting, fit, coupling, values)
    sorted_ = tuple(in_order([*named, *found]))
    standing = {label for its in sorted_ if its.stands_out for label in its.places}
    ladder: dict[Plane, dict[str, float]] = {
        plane: _ladder(ring, mended, fit, nominal[plane], plane, standing)
        for plane in mended.planes
    }
    return Result(ring, measured, mended, optics, fit, coupling, values, sorted_, nominal, ladder)


def check(measured: Measured, nominal: dict[Plane, Matrix]) -> None:
    """Refuse what is not of this ring.

    Raises:
        RingError: With the figure that shows it, and what the matrix looks like.
    """
    for plane in measured.planes:
        data = measured.response[plane, plane]
        there = np.isfinite(data)
        rows, columns = int(there.any(axis=1).sum()), int(there.any(axis=0).sum())
        if min(rows, columns) < 2:
            raise RingError(
                f"plane {plane}: {rows} BPMs by {columns} correctors were measured; with fewer "
                "than two of each a gain cannot be told from a calibration: measure more"
            )
        other = nominal.get("y" if plane == "x" else "x")
        model = nominal[plane]
        size = float(np.nanmedian(row_sizes(data, model))) or 1.0
        told = what_it_looks_like(data / size, model, other) or size_told(data, model)
        if told:
            raise RingError(f"plane {plane}: the response is not taken: {told}")


def _mend(
    ring: Ring, measured: Measured, nominal: dict[Plane, Matrix]
) -> tuple[Measured, list[Named]]:
    """Take out dead devices and put exchanged ones into their places, as seen before the fit."""
    named: list[Named] = []
    for plane in measured.planes:
        for axis, what in ((0, "bpm"), (1, "corrector")):
            data, model = measured.response[plane, plane], nominal[plane]
            labels = (bpm_labels, corrector_labels)[axis](measured, ring, plane)
            data, model = (data, model) if axis == 0 else (data.T, model.T)
            dead = dead_rows(data, model)
            named += [_dead(f"{what}-dead", labels[row], data[row], model[row]) for row in dead]
            measured = _changed(measured, plane, axis, lambda its, d=dead: _without(its, d))
            pairs = exchanges(_without(data, dead), model)
            named += [_exchange(f"{what}-swap", labels, pair) for pair in pairs]
            measured = _changed(measured, plane, axis, lambda its, p=pairs: _swapped(its, p))
    return measured, named


def _changed(
    measured: Measured, plane: Plane, axis: int, change: Callable[[Matrix], Matrix]
) -> Measured:
    """Change the rows of all blocks of the BPMs of a plane (axis 0), or columns (axis 1)."""

    def whole(blocks: Mapping[Pair, Matrix]) -> dict[Pair, Matrix]:
        return {
            pair: its if pair[axis] != plane else change(its) if axis == 0 else change(its.T).T
            for pair, its in blocks.items()
        }

    return replace(measured, response=whole(measured.response), sigma=whole(measured.sigma))


def _exchanged(ring: Ring, measured: Measured, fit: Fit) -> tuple[Measured, list[Named]]:
    """Find exchanges that only the fitted optics tell."""
    named: list[Named] = []
    for plane in measured.planes:
        for axis, what in ((0, "bpm"), (1, "corrector")):
            data, model = measured.response[plane, plane], fit.model[plane]
            pairs = exchanges(data, model) if axis == 0 else exchanges(data.T, model.T)
            labels = (bpm_labels, corrector_labels)[axis](measured, ring, plane)
            named += [_exchange(f"{what}-swap", labels, pair) for pair in pairs]
            measured = _changed(measured, plane, axis, lambda its, p=pairs: _swapped(its, p))
    return measured, named


def _swapped(matrix: Matrix, pairs: list[tuple[int, int]]) -> Matrix:
    found = matrix.copy()
    for first, second in pairs:
        found[[first, second]] = matrix[[second, first]]
    return found


def _without(matrix: Matrix, rows: np.ndarray) -> Matrix:
    found = matrix.copy()
    found[rows] = np.nan
    return found


def _dead(kind: str, label: str, data: np.ndarray, model: np.ndarray) -> Named:
    there = np.isfinite(data)
    share = float(np.linalg.norm(data[there]) / max(float(np.linalg.norm(model[there])), 1e-300))
    what = "BPM" if kind.startswith("bpm") else "Corrector"
    does = "sees" if what == "BPM" else "moves the orbit by"
    text = f"{what} {label} is dead: it {does} {share:.2g} of what the optics say; it is left out."
    return Named(kind, (label,), share - 1.0, float("nan"), "1", 1.0 / DEAD**2, 0.999, text)


def _exchange(kind: str, labels: tuple[str, ...], pair: tuple[int, int]) -> Named:
    first, second = (labels[number] for number in pair)
    what = "BPMs" if kind.startswith("bpm") else "Correctors"
    text = f"{what} {first} and {second} are exchanged: each has the response of the other's place."
    return Named(kind, (first, second), 1.0, float("nan"), "1", 1.0 / DEAD**2, 0.999, text)


def _ladder(
    ring: Ring,
    measured: Measured,
    fit: Fit,
    nominal: Matrix,
    plane: Plane,
    standing: set[str],
) -> dict[str, float]:
    """Relative residuals ‖M − model‖ / ‖M‖ as they are, by one scale, by gains, by the fit."""
    data = measured.response[plane, plane]
    there = np.isfinite(data)
    kept = fit.noise[plane].kept
    known, model = np.where(there, data, 0.0), np.where(there, nominal, 0.0)
    size = float(np.linalg.norm(known)) or 1.0
    scale = float(np.sum(known * model) / max(float(np.sum(model**2)), 1e-300))
    rows, columns = row_and_column_gains(data, nominal)
    gains = np.where(there, rows[:, None] * nominal * columns, 0.0)
    noise = np.where(kept, fit.noise[plane].sigma, 0.0)
    rows_of, columns_of = (
        bpm_labels(measured, ring, plane),
        corrector_labels(measured, ring, plane),
    )
    healthy_rows = [label not in standing for label in rows_of]
    healthy_columns = [label not in standing for label in columns_of]
    healthy = np.ix_(healthy_rows, healthy_columns)
    rest = float(np.linalg.norm(known[healthy])) or 1.0
    return {
        "raw_without_named": float(np.linalg.norm((known - model)[healthy])) / rest,
        "raw": float(np.linalg.norm(known - model)) / size,
        "scale": float(np.linalg.norm(known - scale * model)) / size,
        "gains": float(np.linalg.norm(known - gains)) / size,
        "optics": float(np.linalg.norm(np.where(there, fit.residual[plane], 0.0))) / size,
        "without_outliers": float(np.linalg.norm(np.where(kept, fit.residual[plane], 0.0))) / size,
        "noise": float(np.linalg.norm(noise)) / size,
    }

"""Validate a forward net on another excitation than the one it was trained on.

On more rows of the same loop a net that has learnt the loop's own law instead of the ring looks
excellent: its one-step error is small wherever the change is that function of the reading. Only
changes that are *not* that function tell the two apart: a dither, an exploration, another law.
The law of the training rows is therefore fitted, a = G s + c, and taken out of the changes of the
validation rows; w = a − G s − c is what is left. With p = f(s, a) − f(s, a − w), what the net says
about it, and e the errors of the net,

    slope of the net's answer on the true one = 1 / (1 + β),   β = Σ p e / Σ p²,

is 1 for a right model, and known to σ = 1 / √Σ p² in units of the errors. Where the rows have a
dither or are of an open loop, that part of the changes owes nothing to the noise, w is that part
alone, and one-step errors serve as they are: the slope is right for a wrong net as well. Where
the other excitation is another law, w follows the noise of the readings too; errors and p are
then filtered to innovations, and a slope away from 1 tells a wrong net, but not how wrong.
"""

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.models.forward.net import ForwardNet
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.models.innovations import Noise, innovations, windows
from orbitfb.models.rows import Rows

_MOSTLY_FOREIGN = 0.5
_RIDGE = 1e-9


def orbit_of(rows: Rows) -> Vector:
    """Give s_n of rows that keep it, shape (T, n) [m].

    Raises:
        EstimationError: They do not.
    """
    if rows.orbit is None:
        raise EstimationError("these rows do not keep the orbit; make them with select_rows")
    return rows.orbit


def other_changes(
    training: Rows, validation: Rows, settings: ForwardSettings, response: Vector
) -> tuple[Vector, float, float]:
    """Find the part of the validation's changes that the law of the training does not explain.

    Args:
        training: Rows that a net was trained on.
        validation: Rows to validate it on.
        settings: How large the part must be.
        response: R̂, shape (n, m) [m/A]: changes count by the motion that they make.

    Returns:
        That part w, shape (T, m) [A]; its share of the motion; the share that is left in the
        second half of the training rows when the law is fitted to the first.

    Raises:
        EstimationError: There are too few training rows to know their law, or the validation
            rows have no other excitation.
    """
    needed = 4 * (response.shape[0] + 1)
    if len(training) < needed:
        raise EstimationError(
            f"{len(training)} training rows do not show what law they were made with; {needed} "
            "are needed: record longer"
        )
    half = len(training) // 2
    first, second = training.take(0, half), training.take(half)
    own = _share(_left(first, second) - second.dither, second.change, response)
    left = _left(training, validation)
    share = _share(left, validation.change, response)
    explored = own > _MOSTLY_FOREIGN
    if not explored and share - own < settings.other_share:
        raise EstimationError(
            f"the {len(validation)} validation rows have no other excitation than the training "
            f"rows: their law explains all but {100 * share:.2f} % of the motion "
            f"({100 * own:.2f} % of their own, {100 * settings.other_share:.2f} % more is needed), "
            "and on such rows a net that has learnt the loop's law looks right; validate on rows "
            "with dither, of an exploration in open loop, or of another policy"
        )
    return left, share, own


def validate(
    net: ForwardNet, training: Rows, validation: Rows, noise: Noise, settings: ForwardSettings
) -> dict[str, float]:
    """Judge a net by rows with another excitation.

    Figures: `other_share` and `other_share_training` (see `other_changes`); `validation_r2` of
    s' − s, which even the right model cannot bring to 1; `validation_chi2` and
    `validation_chi2_response`: mean squared innovation of the net and of R̂ alone in units of the
    noise; `slope` and `slope_sigma`: of the net's answer to w on the true one; `slope_response`:
    the same for R̂ alone; `response_error`: |(∂s'/∂a − R̂) w| / |R̂ w|; `spread`: the members'
    disagreement over those motions; `trusted`: 1 when the slope is within the tolerance, known
    well enough to say so, and the innovations are no larger than those of R̂ alone.

    Args:
        net: To judge.
        training: What it was trained on.
        validation: Other rows.
        noise: Of the modes, from the training rows.
        settings: Windows and limits.

    Raises:
        EstimationError: The validation rows have no other excitation, or no stretch is as long as
            a window.
    """
    reference = net.response if np.any(net.response) else net.slope()
    left, share, own = other_changes(training, validation, settings, reference)
    orbit, change = orbit_of(validation), validation.change
    outside = np.where(validation.closed[:, None], validation.dither, change)
    exogenous = _share(outside, change, reference) >= settings.other_share
    if exogenous:
        left = outside
    predicted = net.difference(orbit, change)
    answer = predicted - net.difference(orbit, change - left)
    length = min(128, max(16, settings.window))
    index = windows(validation, length)
    modes = net.coordinates.modes

    def filtered(errors: Vector) -> Vector:
        return innovations(np.where(validation.valid, errors, 0.0), index, noise, modes)

    def slope_of(answer: Vector, errors: Vector) -> tuple[float, float]:
        if not exogenous:
            return _slope(filtered(answer), filtered(errors))
        seen = np.where(validation.valid, answer, 0.0) @ modes
        missed = np.where(validation.valid, errors, 0.0) @ modes
        size = np.sqrt(np.mean(missed**2, axis=0))
        return _slope(seen / size, missed / size)

    difference = validation.difference
    error = filtered(difference - predicted)
    by_response = filtered(difference - change @ reference.T)
    slope, sigma = slope_of(answer, difference - predicted)
    slope_response, _ = slope_of(left @ reference.T, difference - change @ reference.T)
    moved = left @ reference.T
    wrong = left @ (net.slope() - reference).T
    residual = np.where(validation.valid, difference - predicted, 0.0)
    chi2, chi2_response = float(np.mean(error**2)), float(np.mean(by_response**2))
    trusted = (
        abs(slope - 1.0) <= settings.slope_tolerance
        and 2.0 * sigma <= settings.slope_tolerance
        and chi2 <= settings.chi2_tolerance * chi2_response
    )
    return {
        "other_share": share,
        "other_share_training": own,
        "validation_r2": 1.0 - float(np.sum(residual**2) / np.sum(difference**2)),
        "validation_chi2": chi2,
        "validation_chi2_response": chi2_response,
        "slope": slope,
        "slope_sigma": sigma,
        "slope_response": slope_response,
        "response_error": float(np.linalg.norm(wrong) / np.linalg.norm(moved)),
        "spread": float(np.sqrt(np.mean(net.uncertainty(orbit, change) ** 2))),
        "trusted": float(trusted),
    }


def _left(training: Rows, rows: Rows) -> Vector:
    """Take the law of the training rows out of the changes of others."""
    inputs, others = _with_constant(orbit_of(training)), _with_constant(orbit_of(rows))
    size = np.sqrt(np.mean(inputs**2, axis=0)) + np.finfo(float).tiny
    inputs, others = inputs / size, others / size
    moment = inputs.T @ inputs
    moment += _RIDGE * np.trace(moment) / len(moment) * np.eye(len(moment))
    law = np.linalg.solve(moment, inputs.T @ (training.change - training.dither))
    return rows.change - others @ law


def _with_constant(orbit: Vector) -> Vector:
    return np.column_stack([orbit, np.full(len(orbit), 1e-6)])


def _share(part: Vector, whole: Vector, response: Vector) -> float:
    moved = np.sum((whole @ response.T) ** 2)
    return float(np.sum((part @ response.T) ** 2) / max(moved, np.finfo(float).tiny))


def _slope(answer: Vector, error: Vector) -> tuple[float, float]:
    information = float(np.sum(answer**2))
    if information == 0.0:
        return float("inf"), float("inf")
    excess = 1.0 + float(np.sum(answer * error)) / information
    return 1.0 / excess, 1.0 / (float(np.sqrt(information)) * excess**2)

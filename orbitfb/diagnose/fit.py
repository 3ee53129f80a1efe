"""Fit a cause to a record: the exact likelihood, its parameters' intervals, its held-out worth.

The residuals are the white innovations and the sizes of the background; their derivatives come
from differences, so a kind needs no derivative of its own. Held-out worth: the parameters are
fitted on every other block of ticks and judged on the rest, and the other way round (one Newton
step from the common best values). The innovations factorise the likelihood over ticks, so blocks
of one record may be split like this although the filter runs through.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.kinds import Parameter
from orbitfb.physics.optics import Matrix

BLOCK = 25
"""Ticks of a block of the split, and of the variance of the scores."""
_STEPS = 6
_ENOUGH = 0.01
"""Gain of a step below which the search ends [nats]."""
_PARABOLIC = 0.02
"""Difference from a parabola below which its top is the likelihood's [nats]."""
_WIDE = 1.5
"""Prior width of a parameter known by order of magnitude, in its logarithm."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Causes fitted on top of a bench.

    Args:
        causes: With their best values.
        gain: Of the log-likelihood, against the bench [nats].
        white: Innovations with the causes, shape (N, n).
        gains_by_row: Gain of every row, shape (N,) [nats].
        parameters: (cause, parameter) of every fitted value.
        covariance: Of the fitted values (logarithms where `log`), shape (k, k).
        inflation: By how much scores scatter more than the noise model says, at least 1; it has
            been applied to the covariance.
        held_out: Gain on ticks that were not used for the values [nats].
        held_out_by_row: The same by row, shape (N,).
        occam: What the choice of the values costs [nats], not counting places.
        unstable: Fitted values of both halves differ by more than 4 standard deviations.
    """

    causes: tuple[Cause, ...]
    gain: float
    white: Matrix
    gains_by_row: Vector
    parameters: tuple[tuple[int, Parameter], ...]
    covariance: Matrix
    inflation: float
    held_out: float
    held_out_by_row: Vector
    occam: float
    unstable: tuple[bool, ...]

    @property
    def evidence(self) -> float:
        """Log of the Bayes factor for given places under this floor [nats]."""
        return self.gain / self.inflation - self.occam


class _Problem:
    """Fitted values as one vector: logarithms where a parameter is known by magnitude."""

    def __init__(self, bench: Bench, causes: Sequence[Cause]) -> None:
        self.bench, self.causes = bench, tuple(causes)
        self.parameters = tuple(
            (index, parameter)
            for index, cause in enumerate(causes)
            for parameter in cause.kind.parameters
            if parameter.high > parameter.low
        )
        self.start = np.array([self._get(i, p) for i, p in self.parameters])
        self.scale = np.array(
            [_WIDE if p.log else abs(p.typical - p.nominal) for _, p in self.parameters]
        )
        self.low = np.array([_to(p, p.low) for _, p in self.parameters])
        self.high = np.array([_to(p, p.high) for _, p in self.parameters])

    def _get(self, index: int, parameter: Parameter) -> float:
        return _to(parameter, self.causes[index].values[parameter.name])

    def at(self, vector: Vector) -> tuple[Cause, ...]:
        values = [dict(cause.values) for cause in self.causes]
        for (index, parameter), number in zip(self.parameters, vector, strict=True):
            value = float(np.exp(number)) if parameter.log else float(number)
            values[index][parameter.name] = float(np.clip(value, parameter.low, parameter.high))
        return tuple(
            replace(cause, values=own) for cause, own in zip(self.causes, values, strict=True)
        )

    def residual(self, vector: Vector) -> tuple[Matrix, Vector, Vector]:
        return self.bench.residual(self.at(vector))


def _to(parameter: Parameter, value: float) -> float:
    if not parameter.log:
        return value
    return float(np.log(max(value, parameter.low, parameter.high * 1e-9)))


def _width(parameter: Parameter) -> float:
    """Width of the prior: what occurs, or a quarter of what makes sense."""
    if parameter.log:
        return _WIDE
    return abs(parameter.typical - parameter.nominal) or 0.25 * (parameter.high - parameter.low)


def fit(bench: Bench, causes: Sequence[Cause]) -> Fit:
    """Fit all parameters of some causes jointly.

    Args:
        bench: The record under the causes that stay as they are.
        causes: To be fitted, starting from their values.
    """
    problem = _Problem(bench, causes)
    best = problem.start
    now = problem.residual(best)
    if len(best) == 1 and causes[0].kind.linear is None:
        best, now = _line_search(problem, best, now)
    slopes: list[tuple[Matrix, Vector, Vector]] = []
    for step in range(_STEPS):
        slopes = _derivatives(problem, best, now)
        if not slopes:
            break
        gradient, curvature = _normal_equations(now, slopes)
        if not (np.isfinite(curvature).all() and np.isfinite(gradient).all()):
            slopes = []
            break
        move = np.linalg.lstsq(curvature, gradient, rcond=1e-12)[0]
        if gradient @ move < _ENOUGH and step:
            break
        better = _step(problem, best, now, move)
        if better is None:
            break
        before, (best, now) = log_likelihood(*now), better
        if abs(log_likelihood(*now) - before - 0.5 * gradient @ move) < _PARABOLIC:
            break  # the likelihood is the parabola that the step went to the top of
    return _result(problem, best, now, slopes)


def _step(
    problem: _Problem, best: Vector, now: tuple[Matrix, Vector, Vector], move: Vector
) -> tuple[Vector, tuple[Matrix, Vector, Vector]] | None:
    """Go as far as the likelihood grows."""
    before = log_likelihood(*now)
    for share in (1.0, 0.3, 0.1):
        there = np.clip(best + share * move, problem.low, problem.high)
        trial = problem.residual(there)
        if log_likelihood(*trial) > before + 1e-6:
            return there, trial
    return None


def _line_search(
    problem: _Problem, best: Vector, now: tuple[Matrix, Vector, Vector]
) -> tuple[Vector, tuple[Matrix, Vector, Vector]]:
    """Search one parameter in which the likelihood need not be smooth."""
    reach = 0.35 * problem.scale[0] if problem.parameters[0][1].log else 0.5 * abs(best[0])
    low = max(problem.low[0], best[0] - reach)
    high = min(problem.high[0], best[0] + reach)
    if not high > low:
        return best, now
    found = minimize_scalar(
        lambda number: -log_likelihood(*problem.residual(np.array([number]))),
        bounds=(low, high),
        method="bounded",
        options={"maxiter": 12},
    )
    if -float(found.fun) <= log_likelihood(*now):
        return best, now
    there = np.array([float(found.x)])
    return there, problem.residual(there)


def _derivatives(
    problem: _Problem, best: Vector, now: tuple[Matrix, Vector, Vector]
) -> list[tuple[Matrix, Vector, Vector]]:
    found: list[tuple[Matrix, Vector, Vector]] = []
    for index in range(len(best)):
        size = (
            0.02
            if problem.parameters[index][1].log
            else 0.01
            * max(
                abs(best[index] - problem.parameters[index][1].nominal), 0.1 * problem.scale[index]
            )
        )
        if best[index] + size > problem.high[index]:
            size = -size
        there = best.copy()
        there[index] += size
        moved = problem.residual(there)
        found.append(
            (
                (moved[0] - now[0]) / size,
                (moved[1] - now[1]) / size,
                (moved[2] - now[2]) / size,
            )
        )
    return found


def _normal_equations(
    now: tuple[Matrix, Vector, Vector], slopes: list[tuple[Matrix, Vector, Vector]]
) -> tuple[Vector, Matrix]:
    gradient = np.array(
        [
            -np.sum(white * now[0]) - np.sum(sizes * now[1]) + np.sum(jacobian)
            for white, sizes, jacobian in slopes
        ]
    )
    curvature = np.array(
        [[np.sum(a[0] * b[0]) + np.sum(a[1] * b[1]) for b in slopes] for a in slopes]
    )
    return gradient, curvature


def _result(
    problem: _Problem,
    best: Vector,
    now: tuple[Matrix, Vector, Vector],
    slopes: list[tuple[Matrix, Vector, Vector]],
) -> Fit:
    bench = problem.bench
    white, _, jacobian = now
    by_row = _by_row(white, jacobian) - _by_row(bench.white, bench.jacobian)
    gain = log_likelihood(*now) - bench.log_likelihood
    by_row += (gain - by_row.sum()) / len(by_row)  # the background's share belongs to no row
    count = len(slopes)
    if count == 0:
        return Fit(
            problem.at(best),
            gain,
            white,
            by_row,
            (),
            np.zeros((0, 0)),
            1.0,
            float(by_row.sum()),
            by_row,
            0.0,
            (),
        )
    rows = np.stack([-np.sum(s[0] * white, axis=1) + s[2] for s in slopes], axis=1)
    curvature = _normal_equations(now, slopes)[1]
    ridge = np.diag(1.0 / problem.scale**2)
    inverse = np.linalg.pinv(curvature + ridge * 1e-6)
    inflation = _inflation(rows, inverse)
    covariance = inverse * inflation
    held, unstable = _held_out(problem, now, slopes, rows, by_row)
    nominal = np.array(
        [b if p.log else p.nominal for b, (_, p) in zip(best, problem.parameters, strict=True)]
    )
    surprise = np.sum(np.log1p(((best - nominal) / problem.scale) ** 2))
    volume = (
        0.5
        * np.linalg.slogdet(np.eye(count) + curvature * np.outer(problem.scale, problem.scale))[1]
    )
    return Fit(
        problem.at(best), gain, white, by_row, problem.parameters, covariance,
        inflation, float(held.sum()), held, float(volume + surprise), unstable,
    )  # fmt: skip


def _by_row(white: Matrix, jacobian: Vector) -> Vector:
    return -0.5 * np.sum(white**2, axis=1) + jacobian


def _inflation(rows: Matrix, inverse: Matrix) -> float:
    """Compare the scatter of the scores of blocks with what the curvature says."""
    blocks = len(rows) // BLOCK
    if blocks < 8:
        return 1.0
    sums = rows[: blocks * BLOCK].reshape(blocks, BLOCK, -1).sum(axis=1)
    sums -= sums.mean(axis=0)
    scatter = sums.T @ sums
    return max(1.0, float(np.trace(inverse @ scatter)) / len(inverse))


def _held_out(
    problem: _Problem,
    now: tuple[Matrix, Vector, Vector],
    slopes: list[tuple[Matrix, Vector, Vector]],
    rows: Matrix,
    by_row: Vector,
) -> tuple[Vector, tuple[bool, ...]]:
    """Gain of every row when the values come from the other half of the blocks."""
    even = (np.arange(len(rows)) // BLOCK) % 2 == 0
    moves: list[Vector] = []
    inverses: list[Matrix] = []
    for half in (even, ~even):
        curvature = np.array(
            [[np.sum(a[0][half] * b[0][half]) for b in slopes] for a in slopes]
        ) + 0.5 * np.array([[np.sum(a[1] * b[1]) for b in slopes] for a in slopes])
        curvature += 1e-6 * np.diag(1.0 / problem.scale**2)
        inverses.append(np.linalg.pinv(curvature))
        moves.append(inverses[-1] @ rows[half].sum(axis=0))
    held = by_row.copy()
    _judge(held, ~even, now[0], slopes, moves[0])
    _judge(held, even, now[0], slopes, moves[1])
    spread = np.sqrt(np.maximum(np.diagonal(inverses[0] + inverses[1]), 1e-300))
    unstable = tuple(bool(u) for u in np.abs(moves[0] - moves[1]) > 4.0 * spread)
    return held, unstable


def _judge(
    held: Vector,
    half: Mask,
    white: Matrix,
    slopes: list[tuple[Matrix, Vector, Vector]],
    move: Vector,
) -> None:
    change = np.zeros_like(white[half])
    for (slope, _, jacobian), length in zip(slopes, move, strict=True):
        change += slope[half] * length
        held[half] += jacobian[half] * length
    held[half] -= np.sum(change * (white[half] + 0.5 * change), axis=1)

"""Fit a cause to a record: the exact likelihood, its parameters' intervals, its held-out worth.

The residuals are the white innovations and the sizes of the background; their derivatives come
from differences, so a kind needs no derivative of its own. Held-out worth: the parameters are
fitted on every other block of ticks and judged on the rest, and the other way round (one Newton
step from the common best values). The innovations factorise the likelihood over ticks, so blocks
of one record may be split like this although the filter runs through.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose import fit_scores as scores
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit_search import (
    at_nominal,
    ends_of,
    line_search,
    posterior_interval,
    rough_search,
    rough_width,
    tuned,
)
from orbitfb.diagnose.problem import Left, Problem, from_fitted, is_line, to_fitted
from orbitfb.diagnose.standing import is_standing, stilled
from orbitfb.effects.kinds import Parameter
from orbitfb.physics.optics import Matrix

_STEPS = 12
_ENOUGH = 0.01
"""Gain of a step below which the search ends [nats]."""
_PARABOLIC = 0.02
"""Difference from a parabola below which its top is the likelihood's [nats]."""
_SEEN = 100.0
"""Squared change of the innovations beyond which a difference is no derivative any more."""
_SHRINKS = 5
_WIDTH = 1.645
"""Standard deviations of a 90 % interval."""
_IDEAL = 0.02
"""Share of an effect's size by which nature departs from the law that the library has for it."""
_TIMING = 0.05
"""The same for a time constant: when within a tick setpoints come into force is not known."""
_BETTER = 6.0
"""What the search of a value that only bends the likelihood adds to it, at most, where that is
small: its grid is dense [nats]."""
_SHOWN = 10.0
"""What a law must gain beyond its first kicks to be seen at all [nats]."""
_WHOLE = 500.0
"""Reach in a logarithm beyond which an interval covers all bounds."""


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
        ranges: 90 % intervals of values whose likelihood is no parabola, if asked for; else None.
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
    ranges: tuple[tuple[float, float] | None, ...]
    inflation: float
    held_out: float
    held_out_by_row: Vector
    occam: float
    unstable: tuple[bool, ...]

    @property
    def evidence(self) -> float:
        """Log of the Bayes factor for given places under this floor [nats]."""
        return self.gain / self.inflation - self.occam

    @property
    def told(self) -> int:
        """Number of values that the record tells anything about.

        What is left of a current that was constant from the first row on changes nothing.
        """
        within = [self.interval(index) for index in range(len(self.parameters))]
        return sum(
            p.log or low > p.low or high < p.high
            for (low, high), (_, p) in zip(within, self.parameters, strict=True)
        )

    def interval(self, index: int) -> tuple[float, float]:
        """State the 90 % interval of a fitted value, within its bounds."""
        owner, parameter = self.parameters[index]
        told = self.ranges[index]
        if told is not None:
            return told
        centre = to_fitted(parameter, self.causes[owner].values[parameter.name])
        size = 1.0 if parameter.log else abs(centre - parameter.nominal)
        ideal = _TIMING if parameter.unit == "s" else _IDEAL
        ideal = 0.0 if is_line(self.causes[owner].kind, parameter) else ideal
        variance = max(self.covariance[index, index], 0.0) + (ideal * size) ** 2
        reach = _WIDTH * float(np.sqrt(variance))
        reach = min(reach, _WHOLE) if parameter.log else reach
        low, high = (from_fitted(parameter, centre + sign * reach) for sign in (-1.0, 1.0))
        return max(low, parameter.low), min(high, parameter.high)


def fit(
    bench: Bench, causes: Sequence[Cause], *, least: float = -np.inf, precise: bool = False
) -> Fit:
    """Fit all parameters of some causes jointly.

    Args:
        bench: The record under the causes that stay as they are.
        causes: To be fitted, starting from their values.
        least: Evidence that makes them worth anything. Where what is linear gives far less, the
            values beside it stay as they are, known as little as before the data [nats].
        precise: Whether to take the intervals of searched parameters from their likelihood
            itself, which takes a second.
    """
    problem = Problem(bench, causes)
    best, now = tuned(problem, problem.start, problem.residual(problem.start))
    if problem.smooth[:1] == [0] and len(causes) == 1 and causes[0].kind.linear is None:
        best, now = line_search(problem, best, now)
    searched = [index for index in range(len(best)) if index not in problem.smooth]
    if searched and all(cause.kind.linear is not None for cause in causes):
        best, now, slopes = _climb(problem, best, now)
        found = _result(problem, best, now, slopes, searched=(), precise=False)
        if found.evidence + _BETTER < least:
            return found
    for index in searched:
        best = rough_search(problem, best, index)
        now = problem.residual(best)
    best, now, slopes = _climb(problem, best, now)
    if slopes and searched:
        for index in searched:
            best = rough_search(problem, best, index, near=True)
        best, now, slopes = _climb(problem, best, problem.residual(best))
    best, now = at_nominal(problem, best, now, slopes)
    return _result(problem, best, now, slopes, searched=searched, precise=precise)


def _climb(problem: Problem, best: Vector, now: Left) -> tuple[Vector, Left, list[Left]]:
    """Newton's steps in the parameters that have derivatives."""
    slopes: list[Left] = []
    for step in range(_STEPS):
        slopes = _derivatives(problem, best)
        if not slopes:
            break
        padded = (_padded(now[0], problem), *now[1:])
        gradient, curvature = _normal_equations(padded, slopes)
        if not (np.isfinite(curvature).all() and np.isfinite(gradient).all()):
            return best, now, []
        move = np.zeros_like(best)
        move[problem.smooth] = scores.inverse(curvature, problem.scale[problem.smooth]) @ gradient
        promise = float(gradient @ move[problem.smooth])
        if promise < _ENOUGH and step:
            break
        better = _step(problem, best, now, move)
        if better is None:
            break
        before, (best, now) = log_likelihood(*now), better
        if abs(log_likelihood(*now) - before - 0.5 * promise) < _PARABOLIC:
            break  # the likelihood is the parabola that the step went to the top of
    return best, now, slopes


def _step(problem: Problem, best: Vector, now: Left, move: Vector) -> tuple[Vector, Left] | None:
    """Go as far as the likelihood grows."""
    before = log_likelihood(*now)
    for share in (1.0, 0.3, 0.1):
        there = np.clip(best + share * move, problem.low, problem.high)
        trial = problem.residual(there)
        if log_likelihood(*trial) > before + 1e-6:
            return there, trial
    return None


def _derivatives(problem: Problem, best: Vector) -> list[Left]:
    return [_derivative(problem, best, index) for index in problem.smooth]


def _derivative(problem: Problem, best: Vector, index: int) -> Left:
    """Differences over a step that the record just does not see."""
    size = problem.nudge(best, index)
    moved = _moved(problem, best, index, size)
    for _ in range(_SHRINKS):
        seen = float(np.sum(moved[0] ** 2))
        if not seen > _SEEN:
            break
        size /= np.sqrt(seen)
        moved = _moved(problem, best, index, size)
    jacobian = moved[2] / size
    white = _padded(moved[0] / size, problem)
    owner = problem.parameters[index][0]
    channels = max(len(problem.causes[owner].places), 1)
    white[:, owner - len(problem.causes)] = jacobian / np.sqrt(channels)
    return white, moved[1] / size, jacobian


def _moved(problem: Problem, best: Vector, index: int, size: float) -> Left:
    there = best.copy()
    there[index] += size
    return problem.difference(there, best)


def _padded(white: Matrix, problem: Problem) -> Matrix:
    """White innovations beside a column per cause for what scales the readings themselves.

    Scores of a scale g are Σ (e² − 1): their scatter is twice that by the derivative of e alone,
    which the square of the derivative of the Jacobian, shared out over the readings, adds.
    """
    return np.hstack([white, np.zeros((len(white), len(problem.causes)))])


def _normal_equations(now: Left, slopes: list[Left]) -> tuple[Vector, Matrix]:
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


def _steps_alone(bench: Bench, causes: Sequence[Cause], gain: float) -> float:
    """What free first kicks gain beyond their price where the laws add nothing to them [nats].

    The orbit makes a step for many reasons: it does not speak for a law that shows in nothing else.
    """
    still = [stilled(cause, bench.record.layout) for cause in causes if is_standing(cause)]
    if not still:
        return 0.0
    steps = log_likelihood(*bench.residual(still)) - bench.log_likelihood
    shown = gain - steps > _SHOWN
    return 0.0 if shown else max(steps - bench.free_steps.price(causes), 0.0)


def _result(
    problem: Problem,
    best: Vector,
    now: Left,
    slopes: list[Left],
    *,
    searched: Sequence[int],
    precise: bool,
) -> Fit:
    bench = problem.bench
    white, _, jacobian = now
    gains = scores.by_row(white, jacobian) - scores.by_row(bench.white, bench.jacobian)
    gain = log_likelihood(*now) - bench.log_likelihood
    gains += (gain - gains.sum()) / len(gains)  # the background's share belongs to no row
    count, smooth = len(best), problem.smooth
    if len(slopes) < len(smooth):  # none that is finite: nothing is known of them
        nothing = _padded(now[0], problem) * 0.0, np.zeros_like(now[1]), np.zeros_like(now[2])
        slopes = [nothing for _ in smooth]
    covariance = np.zeros((count, count))
    held, unstable = gains, np.zeros(count, dtype=np.bool_)
    volume, inflation = 0.0, 1.0
    if smooth:
        scale = problem.scale[smooth]
        padded = (_padded(white, problem), *now[1:])
        rows = np.stack([-np.sum(s[0] * padded[0], axis=1) + s[2] for s in slopes], axis=1)
        curvature = _normal_equations(padded, slopes)[1]
        inverse = scores.inverse(curvature, scale)
        known = scores.known_by_row(slopes, inverse)
        inflation = scores.inflation(rows, inverse, known)
        covariance[np.ix_(smooth, smooth)] = inverse * inflation
        held, unstable[smooth] = scores.held_out(scale, padded, slopes, rows, gains)
        if held.sum() <= 0.0 and scores.telling(known) < scores.FEW_BLOCKS:
            held = gains  # what shows once or twice is judged by the price of its choice alone
        bent = np.eye(len(smooth)) + curvature * np.outer(scale, scale)
        volume += 0.5 * float(np.linalg.slogdet(bent)[1])
    ranges: list[tuple[float, float] | None] = [None] * count
    unknown = [index for index in range(count) if index not in (*smooth, *searched)]
    covariance[unknown, unknown] = problem.scale[unknown] ** 2
    for index in searched:
        width = rough_width(problem, best, index)
        covariance[index, index] = width**2 * inflation
        volume += 0.5 * float(np.log1p((problem.scale[index] / width) ** 2))
        if precise:
            ends = posterior_interval(problem, best, index, inflation)
            ranges[index] = ends_of(problem, index, ends)
    far = np.array(
        [
            0.0 if p.log else b - p.nominal
            for b, (_, p) in zip(best, problem.parameters, strict=True)
        ]
    )
    far[problem.lines] = 0.0
    surprise = float(np.sum(np.log1p((far / problem.scale) ** 2)))
    found = problem.at(best)
    volume += bench.free_steps.price(found) + _steps_alone(bench, found, gain)
    return Fit(
        found, gain, white, gains, problem.parameters, covariance, tuple(ranges),
        inflation, float(held.sum()), held, volume + surprise, tuple(unstable.tolist()),
    )  # fmt: skip

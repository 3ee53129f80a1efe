"""Search parameters whose likelihood no derivative describes: jumps, whole numbers, waves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import log_likelihood
from orbitfb.diagnose.problem import Left, Problem, from_fitted
from orbitfb.effects.orbit_kinds import SourceKind

_FIRST_TRIALS = np.linspace(-1.0, 1.0, 33)
_TRIALS = np.linspace(-1.0, 1.0, 15)
_FEW_TRIALS = np.linspace(-1.0, 1.0, 7)
"""Where a linear parameter follows, the likelihood bends but does not jump."""
_FIRST_LOOK = 9
"""Values of a bending likelihood that are tried before the best one is searched."""
_REACH = 0.45
"""How far a search goes at first: in the logarithm, or as a share of the value."""
_ZOOM = 0.3
_ZOOMS = 6
_FLAT = 0.3
"""Difference of the likelihood within a window below which nothing is left to find [nats]."""
_BOTTOM = 8.0
"""Drop of the likelihood beyond which values do not count [nats]."""
_POINTS = np.linspace(0.0, 1.0, 25)
_LINES = np.linspace(-1.0, 1.0, 41)
_CLOSER = 3
"""Of the values that were tried roughly, those that are judged as they should be."""
NINETY = 0.05
"""Chance on either side of a stated interval."""


def line_search(problem: Problem, best: Vector, now: Left) -> tuple[Vector, Left]:
    """Search the first parameter, in which the likelihood is continuous but bends."""
    reach = 0.35 * problem.scale[0] if problem.parameters[0][1].log else 0.5 * abs(best[0])
    low = max(problem.low[0], best[0] - reach)
    high = min(problem.high[0], best[0] + reach)
    if not high > low:
        return best, now

    def at(number: float) -> Vector:
        return np.array([number, *best[1:]])

    def depth(number: float) -> float:
        return -log_likelihood(*problem.residual(at(number)))

    trials = np.linspace(low, high, _FIRST_LOOK)
    heights = [problem.likelihood(best, 0, float(number), roughly=True) for number in trials]
    lowest = int(np.argmax(heights))
    around = trials[max(lowest - 1, 0)], trials[min(lowest + 1, len(trials) - 1)]
    found: Any = minimize_scalar(depth, bounds=around, method="bounded", options={"maxiter": 10})
    there = at(float(found.x))
    if -float(found.fun) <= log_likelihood(*now):
        return best, now
    return there, problem.residual(there)


def rough_search(problem: Problem, best: Vector, index: int, *, near: bool = False) -> Vector:
    """Find the best value of a parameter in which the likelihood jumps, by ever closer looks.

    Args:
        problem: All parameters.
        best: Their values so far.
        index: Of the one to search.
        near: Whether it was searched before and only others moved since.

    Returns:
        All values, shape (k,).
    """
    parameter = problem.parameters[index][1]
    if parameter.whole:
        numbers = np.arange(np.ceil(parameter.low), np.floor(parameter.high) + 1.0)
        numbers = numbers[np.abs(numbers - best[index]) <= 6.0]
        top = max(map(float, numbers), key=lambda n: problem.likelihood(best, index, n))
        return problem.beside(best, index, top)[1]
    centre = float(best[index])
    height = problem.likelihood(best, index, centre)
    reach = _REACH if parameter.log else _REACH * (abs(centre) or float(problem.scale[index]))
    reach *= _ZOOM**2 if near else 1.0
    follows = problem.causes[problem.parameters[index][0]].kind.linear is not None
    for zoom in range(_ZOOMS):
        first = zoom == 0 and not near
        offsets = _FEW_TRIALS if follows else _FIRST_TRIALS if first else _TRIALS
        trials = np.clip(centre + reach * offsets, problem.low[index], problem.high[index])
        rough = np.array(
            [problem.likelihood(best, index, t, roughly=True) for t in trials.tolist()]
        )
        for number in trials[np.argsort(rough)[::-1][:_CLOSER]].tolist():
            there = problem.likelihood(best, index, number)
            if there > height:
                centre, height = number, there
        if np.ptp(rough) < _FLAT:
            break
        reach *= _ZOOM
    return problem.beside(best, index, centre)[1]


def rough_width(problem: Problem, best: Vector, index: int) -> float:
    """Standard deviation of a searched parameter, from how steeply the likelihood falls."""
    if problem.parameters[index][1].whole:
        return 0.3
    low, high = _bracket(problem, best, index)
    return max((high - low) / (2.0 * _BOTTOM), 1e-9)


def posterior_interval(problem: Problem, best: Vector, index: int, temper: float) -> tuple[
    float, float
]:  # fmt: skip
    """State a 90 % interval of a searched parameter from its likelihood itself.

    Args:
        problem: All parameters.
        best: Their best values; the others stay.
        index: Of the one.
        temper: By how much scores scatter more than the noise model says.

    Returns:
        Ends, as fitted numbers.
    """
    if problem.parameters[index][1].whole:
        return best[index] - 0.5, best[index] + 0.5
    low, high = _bracket(problem, best, index)
    edges = (low, high)
    for _ in range(3):
        numbers = np.sort(np.append(low + (high - low) * _POINTS, best[index]))
        heights = np.array([problem.likelihood(best, index, float(n)) for n in numbers])
        share = np.exp((heights - heights.max()) / temper)
        middle = 0.5 * (numbers[1:] + numbers[:-1])
        ends = np.array([numbers[0], *middle, numbers[-1]])
        mass = np.append(0.0, np.cumsum(share * np.diff(ends)))
        edges = tuple(np.interp([NINETY, 1.0 - NINETY], mass / mass[-1], ends))
        spacing = (high - low) / (len(_POINTS) - 1)
        if edges[1] - edges[0] > 4.0 * spacing:
            break
        low, high = max(low, edges[0] - 2.0 * spacing), min(high, edges[1] + 2.0 * spacing)
    return min(edges[0], float(best[index])), max(edges[1], float(best[index]))


def _bracket(problem: Problem, best: Vector, index: int) -> tuple[float, float]:
    """Ends between which the likelihood is worth looking at."""
    centre = float(best[index])
    height = problem.likelihood(best, index, centre)
    rough = problem.likelihood(best, index, centre, roughly=True)
    parameter = problem.parameters[index][1]
    first = 1e-6 * (1.0 if parameter.log else max(abs(best[index]), 1e-3 * problem.scale[index]))
    ends: list[float] = []
    for sign, bound in ((-1.0, problem.low[index]), (1.0, problem.high[index])):
        step, end = first, centre
        while step < 1e6 * first:
            end = float(np.clip(centre + sign * step, problem.low[index], problem.high[index]))
            if end == bound:
                break
            if problem.likelihood(best, index, end, roughly=True) < rough - _BOTTOM:
                break
            step *= 3.0
        step = max(step / 9.0, first)
        while step < 1e6 * first:
            end = float(np.clip(best[index] + sign * step, problem.low[index], problem.high[index]))
            if end == bound or problem.likelihood(best, index, end) < height - _BOTTOM:
                break
            step *= 3.0
        ends.append(end)
    return ends[0], ends[1]


def tuned(problem: Problem, best: Vector, now: Left) -> tuple[Vector, Left]:
    """Bring the frequencies of periodic causes to the tops of their lines.

    A frequency is known to a small part of the distance of the lines of a Fourier transform, and
    the likelihood has a top on every side line; between them the score itself is transformed.
    """
    bench = problem.bench
    time = bench.record.time
    length = max(float(time[-1] - time[0]), bench.record.layout.period)
    for owner, cause in enumerate(problem.causes):
        kind = cause.kind
        if not isinstance(kind, SourceKind) or not kind.periodic:
            continue
        where = {p.name: index for index, (its, p) in enumerate(problem.parameters) if its == owner}
        shape = kind.patterns(bench.record.layout)[:, list(cause.places)].sum(axis=1)
        pull = bench.slope @ shape
        frequency, reach = float(best[where["frequency"]]), 1.0 / length
        for _ in range(3):
            trials = np.abs(frequency + reach * _LINES)
            waves = np.exp(-2j * np.pi * np.outer(trials, time)) @ pull
            frequency = float(trials[int(np.argmax(np.abs(waves)))])
            reach /= 20.0
        wave = np.exp(-2j * np.pi * frequency * time) @ pull
        cosine, sine = where["cosine"], where["sine"]
        size = np.hypot(best[cosine], best[sine]) or float(problem.scale[cosine])
        there = best.copy()
        there[where["frequency"]] = frequency
        there[cosine] = size * wave.real / abs(wave)
        there[sine] = -size * wave.imag / abs(wave)
        left = problem.residual(there)
        if log_likelihood(*left) > log_likelihood(*now):
            best, now = there, left
    return best, now


def at_nominal(
    problem: Problem, best: Vector, now: Left, slopes: Sequence[Left]
) -> tuple[Vector, Left]:
    """Leave values nominal of which the record says less than it costs that they are not.

    What is left of a current that was constant from the first row on would go where the noise
    drives it.

    Args:
        problem: All parameters.
        best: Their best values, shape (k,).
        now: What these leave.
        slopes: Derivatives by those that have them.
    """
    for index, slope in zip(problem.smooth, slopes, strict=False):
        owner, parameter = problem.parameters[index]
        linear = parameter.name == problem.causes[owner].kind.linear
        if parameter.log or linear or index in problem.lines:
            continue
        far = best[index] - parameter.nominal
        saved = float(np.log1p((far / problem.scale[index]) ** 2))
        if 0.5 * far**2 * (np.sum(slope[0] ** 2) + np.sum(slope[1] ** 2)) >= saved:
            continue
        there = best.copy()
        there[index] = parameter.nominal
        trial = problem.residual(there)
        if log_likelihood(*trial) > log_likelihood(*now) - saved:
            best, now = there, trial
    return best, now


def ends_of(problem: Problem, index: int, ends: tuple[float, float]) -> tuple[float, float]:
    """Turn ends of fitted numbers into values within the bounds."""
    parameter = problem.parameters[index][1]
    low, high = (from_fitted(parameter, end) for end in ends)
    return max(low, parameter.low), min(high, parameter.high)

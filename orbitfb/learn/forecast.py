"""The loop that a law would make on responses that the data allow, and how two laws compare."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.models.linear import LinearModel

Kicks = Callable[[Vector], tuple[Vector, Vector]]
"""Draws what the steps of the RF leave under two laws on a response, shape (n,) [m] each."""

WORST_RMS = 1.0
"""What a loop that runs away counts as, rms [m]."""


@dataclass(frozen=True, slots=True)
class Prediction:
    """The loop that a law would make.

    Args:
        rms: True orbit after the horizon, mean square over the responses drawn, rms [m].
        growth: Largest growth of the orbit per tick on any of them; below 1 it decays.
        each: True orbit on each response, rms, shape (samples,) [m]; empty: not known.
    """

    rms: float
    growth: float
    each: Vector


@dataclass(frozen=True, slots=True)
class Gain:
    """How much smaller the true orbit would be with the candidate.

    Args:
        mean: In the mean square over the responses drawn, a ratio [1].
        low: Lower end of the 95 % interval for one response that the data allow [1].
        high: Its upper end [1].
    """

    mean: float
    low: float
    high: float


def student(freedom: int) -> float:
    """Give the two-sided 95 % point of Student's t."""
    from scipy.special import stdtrit  # half a second, and only the trainer needs it

    return float(stdtrit(freedom, 0.975))


def paired_gain(ours: Prediction, theirs: Prediction) -> Gain:
    """Give the gain in true orbit, response by response, with its 95 % interval.

    The interval is that of one more response that the data allow, by Student's t over the
    logarithms of the ratios: on a response that one law makes run away the ratio is huge, and
    must not decide alone.

    Args:
        ours: Of the candidate.
        theirs: Of the incumbent, on the same responses.
    """
    ratios = np.log(theirs.each / ours.each)
    count = len(ratios)
    mean = 1.0 - ours.rms / theirs.rms
    if count < 2:
        return Gain(mean, -np.inf, np.inf)
    middle, spread = float(np.mean(ratios)), float(np.std(ratios, ddof=1))
    half = student(count - 1) * spread * np.sqrt(1.0 + 1.0 / count)
    return Gain(mean, *(float(-np.expm1(-end)) for end in (middle - half, middle + half)))


def predict_loop(
    gain: Vector,
    responses: list[Vector],
    model: LinearModel,
    horizon: int,
    kick: Vector | None = None,
) -> Prediction:
    """Predict the true orbit under a law by doubling the covariance recursion.

    x' = (I − R K) x − R K v + w + b, b the creep: mean and covariance after 2k ticks follow from
    those after k, so that `horizon` ticks (rounded up to a power of two) cost log2(horizon)
    products. They are made in single precision: what that loses is far below any margin, and both
    laws lose it alike.

    Args:
        gain: K, shape (m, n) [A/m].
        responses: Responses to average over, each of shape (n, m) [m/A].
        model: Reading noise, ground motion and creep.
        horizon: Ticks from a perfect orbit.
        kick: What the steps of the RF leave at every tick, rms, shape (n,) [m]; None: nothing.
    """
    still = _Still.of(model)
    return _joined([_predict(gain, response, still, horizon, kick) for response in responses])


@dataclass(frozen=True, slots=True)
class _Still:
    """What moves the orbit whatever the law does, in units of the reading noise of a BPM.

    Args:
        unit: That noise, rms [m]; it keeps far from the smallest numbers of single precision.
        ground: Covariance of the step of a tick, shape (n, n) [1].
        creep: Shape (n,) [1].
    """

    unit: float
    ground: Vector
    creep: NDArray[np.float32]

    @classmethod
    def of(cls, model: LinearModel) -> "_Still":
        """Take it from a model."""
        unit = float(np.sqrt(model.reading_variance))
        ground = (model.modes * (model.ground_variances / unit**2)) @ model.modes.T
        return cls(unit, ground, (model.modes @ (model.creep / unit)).astype(np.float32))


def _predict(
    gain: Vector, response: Vector, still: _Still, horizon: int, kick: Vector | None
) -> tuple[float, float]:
    """Give the mean square of the true orbit [m²] and the growth per tick; see `predict_loop`."""
    single = response.astype(np.float32) @ gain.astype(np.float32)
    size, unit = len(single), still.unit
    transition = np.eye(size, dtype=np.float32) - single
    ground = still.ground if kick is None else still.ground + np.outer(kick, kick) / unit**2
    covariance = ground.astype(np.float32) + single @ single.T
    mean, total, norm, ticks = still.creep, float(np.trace(covariance)), 0.0, 1
    with np.errstate(over="ignore", invalid="ignore"):
        while ticks < horizon:
            ticks *= 2
            moved = transition @ covariance
            if ticks < horizon:
                covariance += moved @ transition.T
            else:  # of the last covariance only the trace is wanted
                total = float(np.trace(covariance) + np.vdot(moved, transition))
                norm = float(np.linalg.norm(transition))
            mean = mean + transition @ mean
            transition = transition @ transition
        later = float(np.linalg.norm(transition))
        square = (total + float(mean @ mean)) / size * unit**2
    square = min(square, WORST_RMS**2) if np.isfinite(square) else WORST_RMS**2
    return square, _growth(norm, later, ticks)


def predict_pairs(
    ours: Vector,
    theirs: Vector,
    model: LinearModel,
    horizon: int,
    drawn: Iterable[Vector],
    hopeless: float | None,
    steps: Kicks | None = None,
) -> tuple[list[Vector], Prediction, Prediction]:
    """Predict the loops under two laws on responses drawn one after another.

    The lower end of the interval of `paired_gain` lies below the gain on every single response: of
    n numbers the least is at most (n − 1)/√n standard deviations below their mean, and Student's
    interval for one more reaches further. So one response on which the gain does not pay decides
    where nothing but a resolved gain can.

    Args:
        ours: Gain matrix of the candidate, shape (m, n) [A/m].
        theirs: Of the incumbent.
        model: The posterior of R and the noise.
        horizon: Ticks from a perfect orbit.
        drawn: Responses.
        hopeless: Gain on a response below which no further one is drawn [1]; None: all are.
        steps: Draws what the steps of the RF leave under either law; None: there are none.

    Returns:
        The responses that were drawn, and what both loops do on them.
    """
    still = _Still.of(model)
    responses: list[Vector] = []
    mine: list[tuple[float, float]] = []
    others: list[tuple[float, float]] = []
    for response in drawn:
        responses.append(response)
        left, right = (None, None) if steps is None else steps(response)
        mine.append(_predict(ours, response, still, horizon, left))
        others.append(_predict(theirs, response, still, horizon, right))
        if hopeless is not None and not mine[-1][0] <= (1.0 - hopeless) ** 2 * others[-1][0]:
            break
    return responses, _joined(mine), _joined(others)


def _joined(found: Sequence[tuple[float, float]]) -> Prediction:
    """Make a prediction of the mean square [m²] and the growth on several responses."""
    squares, growth = zip(*found, strict=True)
    return Prediction(float(np.sqrt(np.mean(squares))), max(growth), np.sqrt(squares))


def _growth(earlier: float, later: float, ticks: int) -> float:
    """Give the growth per tick from the transition over half the ticks to that over all."""
    if not np.isfinite(later):
        return float("inf")
    return (later / earlier) ** (2.0 / ticks) if earlier > 0.0 else 0.0

"""Values of effects without a course in time, and how well a record knows them.

Noise by its spectrum (P. Whittle, Ark. Mat. 2 (1953) 423): the steps of what is left have in every
mode the spectrum q + r² |1 − exp(iω)|², to which the effect adds κ(ω) b bᵀ. The floor was fitted
with the effect in the record, so it is fitted again beside the effect. Strikes by their
marginal likelihood, of all rows together where they strike at every row.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_spectra import MOST_PLACES, SHORTEST, Jitter, Spectra, places_struck
from orbitfb.diagnose.problem import from_fitted, prior_width, to_fitted
from orbitfb.diagnose.strike_scan import latent_gain
from orbitfb.diagnose.switching import switched
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

_WIDTH = 1.645
"""Standard deviations of a 90 % interval."""
_ROUNDS = 3
_STEP = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class Stated:
    """A cause with its best values.

    Args:
        cause: With them.
        intervals: 90 % interval of every parameter.
    """

    cause: Cause
    intervals: dict[str, tuple[float, float]]


def state(bench: Bench, cause: Cause) -> Stated:
    """Find the best values of an effect without a course in time.

    Args:
        bench: The record under the causes so far.
        cause: With rough values; places and onset stay.
    """
    kind = cause.kind
    if isinstance(kind, NoiseKind):
        if (followed := switched(bench, cause)) is not None:
            values, intervals = followed
            return Stated(replace(cause, values=values), intervals)
        if not 0 < len(places_struck(bench, cause)) <= MOST_PLACES:
            return _level(bench, cause)
        late = _by_spectrum(bench, cause, slice(cause.onset, None))
        if kind.relative and cause.onset >= SHORTEST:
            nothing = replace(cause, values={p.name: p.nominal for p in kind.parameters})
            return _over(late, _by_spectrum(bench, nothing, slice(0, cause.onset)))
        judged = kind.relative and not bench.told_floor
        return _over(late, _usual(bench, cause)) if judged else late
    if not isinstance(kind, LatentKind):
        raise TypeError(f"{kind.id} has a course in time: fit it")
    if kind.strength == "normal" and not kind.per_bpm:
        return _best(bench, cause, Jitter(bench, kind, cause.places).log_likelihood)
    return _best(bench, cause, lambda values: _struck(bench, replace(cause, values=values)))


def _by_spectrum(bench: Bench, cause: Cause, rows: slice) -> Stated:
    """Best values of a noise in some rows, beside a floor that is fitted with it."""
    spectra = Spectra(bench, cause, rows)
    for _ in range(_ROUNDS):
        cause = _best(bench, cause, spectra.log_likelihood).cause
        spectra.profile(cause.values)
    return _best(bench, cause, spectra.log_likelihood)


def _usual(bench: Bench, cause: Cause) -> Stated:
    """Levels that healthy devices have over those that the floor gives to these.

    The floor takes as healthy what it can of a device that is loud all the time; what such a
    device has without the effect nobody knows but by the others.
    """
    modes, places = bench.floor.modes, list(places_struck(bench, cause))
    level = 1.0 / float(np.sqrt(np.mean(modes.spread[places] ** 2)))
    reach = _WIDTH * 0.5 * modes.scatter / float(np.sqrt(len(places)))
    ends = level * float(np.exp(-reach)), level * float(np.exp(reach))
    return Stated(
        replace(cause, values={p.name: level for p in cause.kind.parameters}),
        {p.name: ends for p in cause.kind.parameters},
    )


def _over(late: Stated, early: Stated) -> Stated:
    """Levels over those that the same devices had before: no two are quite alike."""
    values: dict[str, float] = {}
    intervals: dict[str, tuple[float, float]] = {}
    for p in late.cause.kind.parameters:
        ratio = late.cause.values[p.name] / early.cause.values[p.name]
        value = float(np.clip(ratio, p.low, p.high))
        its, before = _reaches(late, p.name), _reaches(early, p.name)
        values[p.name] = value
        intervals[p.name] = (
            max(value * float(np.exp(-np.hypot(its[0], before[1]))), p.low),
            min(value * float(np.exp(np.hypot(its[1], before[0]))), p.high),
        )
    return Stated(replace(late.cause, values=values), intervals)


def _reaches(stated: Stated, name: str) -> tuple[float, float]:
    """How far the ends of an interval are from the value, in logarithms, down and up."""
    low, high = stated.intervals[name]
    value = stated.cause.values[name]
    return float(np.log(value / low)), float(np.log(high / value))


def likelihood_of(bench: Bench, cause: Cause) -> Callable[[Values], float]:
    """Log-likelihood of a noise's values at its places under the floor, up to a constant [nats]."""
    return Spectra(bench, cause, slice(cause.onset, None)).log_likelihood


def _level(bench: Bench, cause: Cause) -> Stated:
    """Levels of all places together keep their values; their interval is that of a variance.

    A colour has the interval of a correlation instead, as one BPM alone would tell it.
    """
    rows = max(len(bench.record) - cause.onset, 2)
    if isinstance(cause.kind, NoiseKind) and cause.kind.lag:
        far = _WIDTH / np.sqrt(rows)
        return Stated(
            cause,
            {
                p.name: (
                    float(np.clip(cause.values[p.name] - far, p.low, p.high)),
                    float(np.clip(cause.values[p.name] + far, p.low, p.high)),
                )
                for p in cause.kind.parameters
            },
        )
    reach = _WIDTH * np.sqrt(0.5 / rows)
    intervals = {
        p.name: (
            max(cause.values[p.name] * float(np.exp(-reach)), p.low),
            min(cause.values[p.name] * float(np.exp(reach)), p.high),
        )
        for p in cause.kind.parameters
    }
    return Stated(cause, intervals)


def _struck(bench: Bench, cause: Cause) -> float:
    assert isinstance(cause.kind, LatentKind)  # noqa: S101
    return float(np.sum(latent_gain(bench, cause.kind, cause.values, cause.places)))


def _best(bench: Bench, cause: Cause, height: Callable[[Values], float]) -> Stated:
    parameters = cause.kind.parameters
    scale = np.array([1.0 if p.log else prior_width(p) for p in parameters])
    start = np.array([to_fitted(p, cause.values[p.name]) for p in parameters]) / scale

    def values_at(vector: Vector) -> dict[str, float]:
        return {
            p.name: float(
                np.clip(from_fitted(p, float(v * s)), max(p.low, p.high * 1e-9 * p.log), p.high)
            )
            for p, v, s in zip(parameters, vector, scale, strict=True)
        }

    def depth(vector: Vector) -> float:
        value = height(values_at(vector))
        return -value if np.isfinite(value) else 1e12

    simplex = np.vstack([start, start + 0.2 * np.eye(len(start))])
    options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-2, "maxiter": 120}
    found = minimize(depth, start, method="Nelder-Mead", options=options)
    best = np.asarray(found.x, dtype=np.float64)
    deviation = _deviations(depth, best)
    for index, p in enumerate(parameters):
        deviation[index] = np.hypot(deviation[index], _chance(bench, cause, p, values_at(best)))
    intervals: dict[str, tuple[float, float]] = {}
    for p, at, its, s in zip(parameters, best, deviation, scale, strict=True):
        reach = _WIDTH * min(float(its), 100.0)
        low, high = (from_fitted(p, float((at + sign * reach) * s)) for sign in (-1.0, 1.0))
        intervals[p.name] = (max(low, p.low), min(high, p.high))
    return Stated(replace(cause, values=values_at(best)), intervals)


def _deviations(depth: Callable[[Vector], float], best: Vector) -> Vector:
    """Standard deviations from the curvature of the likelihood."""
    count = len(best)
    step = _STEP * np.eye(count)
    bottom = depth(best)
    curvature = np.zeros((count, count))
    for i in range(count):
        for j in range(i + 1):
            if i == j:
                around = depth(best + step[i]) + depth(best - step[i])
                curvature[i, i] = (around - 2.0 * bottom) / _STEP**2
            else:
                a, b = step[i], step[j]
                mixed = depth(best + a + b) - depth(best + a - b)
                mixed -= depth(best - a + b) - depth(best - a - b)
                curvature[i, j] = curvature[j, i] = mixed / (4.0 * _STEP**2)
    values, vectors = np.linalg.eigh(curvature)
    covariance = (vectors / np.maximum(values, 1e-2)) @ vectors.T
    return np.sqrt(np.diagonal(covariance))


def _chance(bench: Bench, cause: Cause, parameter: Parameter, values: Values) -> float:
    """Scatter beyond the spectrum's, of a parameter as it is fitted.

    The spectrum takes the few strokes of a rare kind for many small ones, and the level beside a
    colour as known: without it a correlation ρ scatters by √((1 − ρ²) / N) (G. E. P. Box and G. M.
    Jenkins, Time Series Analysis (1970) ch. 7).
    """
    if not isinstance(cause.kind, NoiseKind):
        return 0.0
    if cause.kind.lag:
        count = (len(bench.record) - cause.onset) * max(len(cause.places), 1)
        return float(np.sqrt((1.0 - values[parameter.name] ** 2) / count)) / prior_width(parameter)
    if not cause.kind.rare:
        return 0.0
    strokes = max(values["probability"] * (len(bench.record) - cause.onset), 1.0)
    # the size goes with the root of what the spectrum tells
    return (1.0 if parameter.name == "probability" else 0.5) / float(np.sqrt(strokes))

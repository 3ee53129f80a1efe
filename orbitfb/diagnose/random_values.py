"""Values of effects without a course in time, and how well a record knows them.

Noise by its spectrum (P. Whittle, Ark. Mat. 2 (1953) 423): the steps of what is left have in every
mode the spectrum q + r² |1 − exp(iω)|², to which the effect adds κ(ω) b bᵀ. The floor was fitted
with the effect in the record, so it is fitted again beside the effect. Strikes by their
marginal likelihood, of all rows together where they strike at every row.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.optimize import minimize
from scipy.signal.windows import tukey

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, explain
from orbitfb.diagnose.problem import from_fitted, prior_width, to_fitted
from orbitfb.diagnose.randomness import usual_reading, wanders
from orbitfb.diagnose.strike_scan import latent_gain, strikes
from orbitfb.diagnose.switching import switched
from orbitfb.diagnose.wandering import Wandering
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

_WIDTH = 1.645
"""Standard deviations of a 90 % interval."""
_TAPER = 0.1
_SHORTEST = 64
"""Rows of a stretch that has a spectrum worth looking at."""
_LEAST = 0.01
"""Share of the floor's walk that a mode has at least."""
_SCORING = 4
_ROUNDS = 3
_LAGS = 30
_MOST_PLACES = 12
_STEP = 0.02


Spectrum = NDArray[np.complex128]


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
        if not 0 < len(_places(bench, cause)) <= _MOST_PLACES:
            return _level(bench, cause)
        if wanders(bench, kind):
            walk = Wandering(bench, kind.patterns(bench.record.layout)[:, 0])
            if walk.seen:
                reading = float(np.sqrt(bench.floor.reading))
                return _best(bench, cause, lambda values: walk.gain(kind.variance(values, reading)))
        late = _by_spectrum(bench, cause, slice(cause.onset, None))
        if kind.relative and cause.onset >= _SHORTEST:
            nothing = replace(cause, values={p.name: p.nominal for p in kind.parameters})
            return _over(late, _by_spectrum(bench, nothing, slice(0, cause.onset)))
        return late
    if not isinstance(kind, LatentKind):
        raise TypeError(f"{kind.id} has a course in time: fit it")
    if kind.strength == "normal" and not kind.per_bpm:
        return _best(bench, cause, _Jitter(bench, kind).log_likelihood)
    return _best(bench, cause, lambda values: _struck(bench, replace(cause, values=values)))


def _by_spectrum(bench: Bench, cause: Cause, rows: slice) -> Stated:
    """Best values of a noise in some rows, beside a floor that is fitted with it."""
    spectra = _Spectra(bench, cause, rows)
    for _ in range(_ROUNDS):
        cause = _best(bench, cause, spectra.log_likelihood).cause
        spectra.profile(cause.values)
    return _best(bench, cause, spectra.log_likelihood)


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
    return _Spectra(bench, cause, slice(cause.onset, None)).log_likelihood


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


def _places(bench: Bench, cause: Cause) -> tuple[int, ...]:
    kind = cause.kind
    if isinstance(kind, NoiseKind) and not cause.places:
        count = len(kind.places_of(bench.record.layout))
        return (0,) if count == 1 else ()
    return cause.places


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
    """Scatter by the few strokes of a rare kind, whose spectrum takes them for many small ones."""
    if not (isinstance(cause.kind, NoiseKind) and cause.kind.rare):
        return 0.0
    strokes = max(values["probability"] * (len(bench.record) - cause.onset), 1.0)
    # the size goes with the root of what the spectrum tells
    return (1.0 if parameter.name == "probability" else 0.5) / float(np.sqrt(strokes))


class _Spectra:
    """Steps of what is left, Fourier transformed stretch by stretch."""

    def __init__(self, bench: Bench, cause: Cause, within: slice) -> None:
        kind = cause.kind
        assert isinstance(kind, NoiseKind)  # noqa: S101
        self._kind, self._floor, self._told = kind, bench.floor, bench.told_floor
        record = bench.record
        left = explain(record, bench.causes, bench.orbit).left - bench.background.orbit(bench.sizes)
        modal = bench.floor.to_modes(left)
        places = list(_places(bench, cause))
        self._walk, self._reading = bench.floor.walk, bench.floor.reading
        at = np.array(places)
        self._noise = float(np.sqrt(usual_reading(bench, kind, at)))
        self._shapes = bench.floor.modes.directions.T @ kind.patterns(record.layout)[:, places]
        self._parts: list[tuple[Spectrum, Spectrum, float]] = []
        for stretch in record.stretches:
            first, end, _ = within.indices(stretch.stop)
            rows = modal[max(stretch.start, first) : end]
            if len(rows) < _SHORTEST:
                continue
            window = tukey(len(rows) - 1, _TAPER)
            steps = np.diff(rows, axis=0) * (window / np.sqrt(np.sum(window**2)))[:, None]
            lines = np.fft.rfft(steps, axis=0)[1:-1]
            turn = np.exp(-2j * np.pi * np.arange(1, len(lines) + 1) / len(steps))
            weight = float(np.sum(window**2) ** 2 / np.sum(window**4)) / len(window)
            self._parts.append((lines, turn, weight))

    def log_likelihood(self, values: Values) -> float:
        """Whittle's, up to a constant [nats]."""
        total = 0.0
        for lines, turn, weight in self._parts:
            density, solved, _, size = self._solved(values, lines, turn)
            if solved is None:
                return -np.inf
            cost = np.sum(np.log(density)) + np.sum((np.conj(lines) * solved).real)
            total -= weight * float(cost + np.sum(size))
        return total

    def profile(self, values: Values) -> None:
        """Fit reading noise and every mode's walk beside the effect, by Fisher's scoring."""
        if self._told:
            return
        for _ in range(_SCORING):
            score, known = np.zeros_like(self._walk), np.zeros_like(self._walk)
            level = np.zeros(2)
            for lines, turn, _weight in self._parts:
                _, solved, inverse, _ = self._solved(values, lines, turn)
                if solved is None:
                    return
                surplus = np.abs(solved) ** 2 - inverse
                step = np.abs(1.0 - turn)[:, None] ** 2
                score += np.sum(surplus, axis=0)
                known += np.sum(inverse**2, axis=0)
                level += np.sum(step * surplus), np.sum((step * inverse) ** 2)
            walk = np.clip(self._walk + score / known, 0.3 * self._walk, 3.0 * self._walk)
            self._walk = np.maximum(walk, _LEAST * self._floor.walk)
            self._reading *= float(np.clip(1.0 + level[0] / level[1] / self._reading, 0.7, 1.4))

    def _solved(
        self, values: Values, lines: Spectrum, turn: Spectrum
    ) -> tuple[Matrix, Spectrum | None, Matrix, Vector]:
        """Spectrum of the floor, Φ⁻¹ d, the diagonal of Φ⁻¹, and its share of log |Φ|."""
        shapes, added = self._shapes, self._kind.spectrum(values, self._noise, turn)
        density = self._walk + self._reading * np.abs(1.0 - turn)[:, None] ** 2
        over = shapes[None] / density[:, :, None]
        inner = np.eye(shapes.shape[1]) + added[:, None, None] * (shapes.T @ over)
        sign, size = np.linalg.slogdet(inner)
        if np.any(sign <= 0):
            return density, None, density, size
        back = added[:, None, None] * np.linalg.inv(inner)
        pull = np.einsum("fnp,fn->fp", over, lines)
        pulled = np.einsum("fpq,fq->fp", back, pull)
        solved = lines / density - np.einsum("fnp,fp->fn", over, pulled)
        inverse = 1.0 / density - np.einsum("fnp,fnp->fn", over @ back, over)
        return density, solved, inverse, size


class _Jitter:
    """Strikes of normal strength at every row: neighbours share innovations, so all together."""

    def __init__(self, bench: Bench, kind: LatentKind) -> None:
        score, _ = strikes(bench, kind)
        shapes = bench.floor.to_modes(kind.shapes(bench.record, bench.currents, bench.orbit))
        gains, variance = bench.floor.gains, bench.floor.innovation_variance
        rows = len(shapes)
        self._score = score[:, 0]
        self._band = np.zeros((_LAGS + 1, rows))
        for lag in range(_LAGS + 1):
            if lag == 0:
                echo = 1.0 + gains / (2.0 - gains)
            else:
                echo = -gains * (1.0 - gains) ** (lag - 1) / (2.0 - gains)
            both = (shapes[lag:] * shapes[: rows - lag]) @ (echo / variance)
            self._band[lag, : rows - lag] = both
        self._name = kind.parameters[0].name

    def log_likelihood(self, values: Values) -> float:
        size = values[self._name] ** 2
        band = size * self._band
        band[0] += 1.0
        try:
            root = cholesky_banded(band, lower=True)
        except np.linalg.LinAlgError:
            return -np.inf
        solved = cho_solve_banded((root, True), self._score)
        determinant = float(np.sum(np.log(root[0])))
        return 0.5 * size * float(self._score @ solved) - determinant

"""How likely sizes of noise are: by the spectrum of what is left, or by strikes at every row.

The steps of what is left have in every mode the spectrum q + r² |1 − exp(iω)|², to which an effect
adds κ(ω) b bᵀ (P. Whittle, Ark. Mat. 2 (1953) 423).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.signal.windows import tukey

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, explain
from orbitfb.diagnose.innovation import stretches
from orbitfb.diagnose.standing import stretches_across
from orbitfb.diagnose.strike_scan import shapes_at, strikes
from orbitfb.effects.kinds import Values
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_TAPER = 0.1
SHORTEST = 64
"""Rows of a stretch that has a spectrum worth looking at."""
_LEAST = 0.01
"""Share of the floor's walk that a mode has at least."""
_SCORING = 4
_LAGS = 30

MOST_PLACES = 12
"""Places that share a spectrum of their own at most: the work grows with their square."""

Spectrum = NDArray[np.complex128]


def places_struck(bench: Bench, cause: Cause) -> tuple[int, ...]:
    """Give the places of a noise; empty where it has none of its own."""
    kind = cause.kind
    if isinstance(kind, NoiseKind) and not cause.places:
        count = len(kind.places_of(bench.record.layout))
        return (0,) if count == 1 else ()
    return cause.places


def usual_reading(bench: Bench, kind: NoiseKind, places: Indices) -> float:
    """Variance of the reading noise that sizes at some places are relative to [m²]."""
    if kind.relative or kind.lag:
        return float(np.mean(bench.floor.readings[places]))
    return bench.floor.reading


class Spectra:
    """Steps of what is left, Fourier transformed stretch by stretch."""

    def __init__(self, bench: Bench, cause: Cause, within: slice = slice(None)) -> None:
        kind = cause.kind
        assert isinstance(kind, NoiseKind)  # noqa: S101
        self._kind, self._floor, self._told = kind, bench.floor, bench.told_floor
        record = bench.record
        left = explain(record, bench.causes, bench.orbit).left - bench.background.orbit(bench.sizes)
        modal = bench.floor.to_modes(left)
        places = list(places_struck(bench, cause))
        self._walk, self._reading = bench.floor.walk, bench.floor.reading
        self._noise = np.sqrt(
            [usual_reading(bench, kind, np.array([place])) for place in places]
        ).tolist()
        self._shapes = bench.floor.modes.directions.T @ kind.patterns(record.layout)[:, places]
        self._parts: list[tuple[Spectrum, Spectrum, float]] = []
        self._alternate: list[Spectrum] = []
        for stretch in stretches(stretches_across(record, bench.causes)):
            first, end, _ = within.indices(stretch.stop)
            rows = modal[max(stretch.start, first) : end]
            if len(rows) < SHORTEST:
                continue
            window = tukey(len(rows) - 1, _TAPER)
            steps = np.diff(rows, axis=0) * (window / np.sqrt(np.sum(window**2)))[:, None]
            lines = np.fft.rfft(steps, axis=0)[1:-1]
            turn = np.exp(-2j * np.pi * np.arange(1, len(lines) + 1) / len(steps))
            signs = (-1.0) ** np.arange(len(steps))
            self._alternate.append((signs @ steps)[None].astype(np.complex128))
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

    def walk_scores(self, patterns: Matrix) -> tuple[Vector, Vector]:
        """Differentiate by the variance of a walk of each pattern, at the floor as it is.

        Args:
            patterns: Orbits per unit, shape (n, P).

        Returns:
            Score and information [nats per variance per tick, and its square], shape (P,) each.
        """
        shapes = self._floor.modes.directions.T @ patterns
        score, info = np.zeros(shapes.shape[1]), np.zeros(shapes.shape[1])
        for lines, turn, weight in self._parts:
            density = self._walk + self._reading * np.abs(1.0 - turn)[:, None] ** 2
            expected = (1.0 / density) @ shapes**2
            seen = np.abs((lines / density) @ shapes) ** 2
            score += weight * np.sum(seen - expected, axis=0)
            info += weight * np.sum(expected**2, axis=0)
        return score, info

    def surplus(self, values: Values) -> list[tuple[Matrix, float]]:
        """Tell by how much the places' noise exceeds what is expected of it, line by line.

        Returns:
            For every stretch, (u − 1) of shape (F, P) with u of mean one, exponentially distributed
            where the law holds; and the weight of its lines, which the window has made fewer.
        """
        return [(self._surplus(values, lines, turn), w) for lines, turn, w in self._parts]

    def alternating(self, values: Values) -> Matrix:
        """The same of what changes its sign from row to row, the sum over P places, shape (S,).

        It is one real number, so that u has the distribution of a square of a normal one.
        """
        turn = np.full(1, -1.0 + 0.0j)
        each = [self._surplus(values, lines, turn).sum() for lines in self._alternate]
        return np.array(each)

    def _surplus(self, values: Values, lines: Spectrum, turn: Spectrum) -> Matrix:
        density, back, _ = self._inverse(values, turn)
        if not len(back):
            return np.zeros((len(lines), self._shapes.shape[1]))
        over = self._shapes[None] / density[:, :, None]
        # bᵀ Φ⁻¹ d and the diagonal of bᵀ Φ⁻¹ b
        seen = np.einsum("np,fnq->fpq", self._shapes, over)
        pull = np.einsum("fnp,fn->fp", over, lines)
        pull = pull - np.einsum("fpq,fqr,fr->fp", seen, back, pull)
        expected = np.einsum("fpp->fp", seen - seen @ back @ seen)
        return np.abs(pull) ** 2 / expected - 1.0

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
            if not (np.all(known > 0.0) and level[1] > 0.0):  # no noise of these values is one
                return
            walk = np.clip(self._walk + score / known, 0.3 * self._walk, 3.0 * self._walk)
            self._walk = np.maximum(walk, _LEAST * self._floor.walk)
            self._reading *= float(np.clip(1.0 + level[0] / level[1] / self._reading, 0.7, 1.4))

    def _solved(
        self, values: Values, lines: Spectrum, turn: Spectrum
    ) -> tuple[Matrix, Spectrum | None, Matrix, Vector]:
        """Spectrum of the floor, Φ⁻¹ d, the diagonal of Φ⁻¹, and its share of log |Φ|."""
        density, back, size = self._inverse(values, turn)
        if not len(back):
            return density, None, density, size
        over = self._shapes[None] / density[:, :, None]
        pull = np.einsum("fnp,fn->fp", over, lines)
        pulled = np.einsum("fpq,fq->fp", back, pull)
        solved = lines / density - np.einsum("fnp,fp->fn", over, pulled)
        inverse = 1.0 / density - np.einsum("fnp,fnp->fn", over @ back, over)
        return density, solved, inverse, size

    def _inverse(self, values: Values, turn: Spectrum) -> tuple[Matrix, Matrix, Vector]:
        """Floor D, and X and log |Φ| − log |D| of Φ⁻¹ = D⁻¹ − D⁻¹ b X bᵀ D⁻¹; no X where Φ is none.

        Shapes (F, n), (F, P, P), (F,).
        """
        shapes = self._shapes
        added = np.stack([self._kind.spectrum(values, one, turn) for one in self._noise], axis=1)
        density = self._walk + self._reading * np.abs(1.0 - turn)[:, None] ** 2
        over = shapes[None] / density[:, :, None]
        inner = np.eye(shapes.shape[1]) + added[:, :, None] * (shapes.T @ over)
        sign, size = np.linalg.slogdet(inner)
        if np.any(sign <= 0):
            return density, np.zeros((0, 0, 0)), size
        return density, np.linalg.inv(inner) * added[:, None, :], size


class Jitter:
    """Strikes of normal strength at every row: neighbours share innovations, so all together."""

    def __init__(self, bench: Bench, kind: LatentKind, places: Sequence[int] = ()) -> None:
        score, _ = strikes(bench, kind, places)
        shapes = bench.floor.to_modes(shapes_at(bench, kind, places))
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
        """Of all rows together, up to a constant [nats]."""
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

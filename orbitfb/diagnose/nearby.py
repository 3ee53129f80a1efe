"""Neighbouring places that a record cannot exclude, and what they do to the values.

Sources in one straight section act nearly alike, so that a record often leaves open which of them
it is; the size that belongs to each is another one. The intervals are those of the mixture.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.problem import from_fitted, to_fitted
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix

_ALIKE = 0.9
"""Cosine of two patterns, as the noise sees them, from which on places are neighbours."""
_MOST = 8
_CERTAIN = 0.95
"""Probability of the places that are told."""
_TAILS = (0.05, 0.95)
_POINTS = 4001
_REACH = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Nearby:
    """Places of a cause that a record cannot exclude.

    Args:
        places: The likeliest first, its own among them.
        intervals: 90 % intervals of the values, whichever place it is, by name of the parameter.
    """

    places: tuple[int, ...]
    intervals: dict[str, tuple[float, float]]


def nearby(bench: Bench, entry: Entry) -> Nearby | None:
    """Fit a cause at the places next to its own.

    Args:
        bench: The record under the causes accepted before it.
        entry: The cause.

    Returns:
        None where it is no source at a single place.
    """
    kind, own = entry.kind, entry.cause
    if not isinstance(kind, SourceKind) or len(own.places) != 1 or entry.fit is None:
        return None
    patterns = kind.patterns(bench.record.layout)
    fits: dict[int, Fit] = {}
    for place in neighbours(bench, patterns, own.places[0]):
        there = type(own)(kind, (place,), own.values, own.onset)
        fits[place] = fit(bench, (there,))
    gains = np.array([one.gain for one in fits.values()]) / entry.fit.inflation
    weights = np.exp(gains - gains.max())
    weights /= weights.sum()
    order = np.argsort(weights)[::-1]
    kept = order[: 1 + int(np.searchsorted(np.cumsum(weights[order]), _CERTAIN))]
    places = list(fits)
    return Nearby(
        tuple(places[int(i)] for i in kept), _intervals([*fits.values()], weights, entry.fit)
    )


def neighbours(bench: Bench, patterns: Matrix, place: int) -> list[int]:
    """List a place itself and those whose patterns are like its own, the likest first.

    Args:
        bench: Its noise tells what is alike.
        patterns: Orbit of every place, shape (n, P).
        place: Of these.
    """
    modal = bench.floor.seen(patterns)
    modal /= np.maximum(np.linalg.norm(modal, axis=0), 1e-300)
    alike = np.abs(modal.T @ modal[:, place])
    order = np.argsort(alike)[::-1][:_MOST]
    return [int(i) for i in order if alike[i] > _ALIKE]


def _intervals(fits: list[Fit], weights: Vector, own: Fit) -> dict[str, tuple[float, float]]:
    found: dict[str, tuple[float, float]] = {}
    for index, (_, parameter) in enumerate(own.parameters):
        centres = np.array(
            [to_fitted(parameter, one.causes[0].values[parameter.name]) for one in fits]
        )
        widths = np.sqrt([max(float(one.covariance[index, index]), 0.0) for one in fits])
        if own.ranges[index] is not None or not np.all(np.isfinite(widths)) or not widths.all():
            continue
        low, high = mixture_interval(centres, widths, weights)
        ends = (from_fitted(parameter, low), from_fitted(parameter, high))
        found[parameter.name] = (max(ends[0], parameter.low), min(ends[1], parameter.high))
    return found


def mixture_interval(centres: Vector, widths: Vector, weights: Vector) -> tuple[float, float]:
    """State the 90 % interval of a mixture of normal distributions.

    Args:
        centres: Shape (k,).
        widths: Standard deviations, shape (k,).
        weights: That add up to 1, shape (k,).
    """
    low = float(np.min(centres - _REACH * widths))
    high = float(np.max(centres + _REACH * widths))
    grid = np.linspace(low, high, _POINTS)
    below = weights @ norm.cdf((grid - centres[:, None]) / widths[:, None])
    ends = np.interp(_TAILS, below, grid)
    return float(ends[0]), float(ends[1])

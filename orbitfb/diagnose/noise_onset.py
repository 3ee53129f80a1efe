"""From when on there is more noise (or less): before that the places are their own reference."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import FIRST_ONSET, LAST_ONSET, Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_spectra import MOST_PLACES, usual_reading
from orbitfb.diagnose.random_values import likelihood_of, state
from orbitfb.diagnose.randomness import (
    LEAST_COLOUR,
    beyond_healthy,
    parted,
    projections,
    values_of,
)
from orbitfb.effects.random_kinds import NoiseKind

_ONSET_WORTH = 4.0
"""Gain of a beginning beyond the price of its choice [nats]."""
_COLOURS = 25
"""Weaker ones that healthy noise may have, of each BPM for itself: what they explain is no evidence
of a stronger one."""
_STRIKING = 10.0
"""Gain from which a colour is looked at closely [nats]."""


def begun_noise(bench: Bench, candidate: Candidate) -> Candidate:
    """Let a noise begin at the row that explains the record best, if it was not always there.

    Args:
        bench: The record under the causes accepted so far.
        candidate: With a noise that has places; another is given back as it is.
    """
    cause, kind = candidate.cause, candidate.cause.kind
    if not isinstance(kind, NoiseKind) or not kind.sudden or cause.onset or not cause.places:
        return candidate
    if kind.rare or kind.colour == "walk" or candidate.group == "all":
        return candidate
    if kind.lag:
        return _coloured(bench, candidate, kind)
    course, size = projections(bench, kind.patterns(bench.record.layout)[:, list(cause.places)])
    squares = course**2 / size
    rows, gain, before, after = parted(squares.mean(axis=1, keepdims=True), len(cause.places))
    row = int(rows[0])
    beyond = float(gain[0]) - float(np.log(len(squares)))
    if beyond < _ONSET_WORTH:
        return candidate
    early, late = squares[:row].mean(axis=0), squares[row:].mean(axis=0)
    reading = usual_reading(bench, kind, np.array(cause.places))
    values = values_of(kind, float(np.mean((late - early) / size)), reading)
    if values is None:
        return candidate
    sure = float(beyond_healthy(np.array([beyond]), after / before)[0])
    alone = None if candidate.alone is None else candidate.alone + beyond
    return replace(
        candidate,
        cause=replace(cause, values=values, onset=row),
        gain=max(candidate.gain, sure),
        alone=alone,
    )


def _coloured(bench: Bench, candidate: Candidate, kind: NoiseKind) -> Candidate:
    """Judge a colour by the whole spectrum, from the row on that explains the record best.

    The correlation of neighbouring rows, by which it was found, is a small part of a strong one.
    """
    cause = candidate.cause
    if not 0 < len(cause.places) <= MOST_PLACES or candidate.gain < _STRIKING:
        return candidate
    patterns = kind.patterns(bench.record.layout)[:, list(cause.places)]
    course, size = projections(bench, patterns)
    course = course / np.sqrt(size)
    products = np.mean(course[kind.lag :] * course[: -kind.lag], axis=1)
    left = np.arange(len(products), 0, -1)
    heights = 0.5 * len(cause.places) * np.cumsum(products[::-1])[::-1] ** 2 / left
    always = float(heights[0])
    heights[:FIRST_ONSET] = heights[-LAST_ONSET:] = 0.0
    row = int(np.argmax(heights))
    price = float(np.log(len(products))) + _ONSET_WORTH
    best = _by_spectrum(bench, cause)
    if heights[row] - always > price:  # else it is not worth its time
        begun = _by_spectrum(bench, replace(cause, onset=row))
        late = replace(begun, gain=begun.gain - price, sure=begun.sure - price)
        best = max(best, late, key=lambda one: one.gain)
    if best.sure <= candidate.gain:
        return candidate
    return replace(candidate, cause=best.cause, gain=best.sure, alone=best.gain)


@dataclass(frozen=True, slots=True)
class _Colour:
    """A noise with its best values, what it gains by them, and beyond healthy noise [nats]."""

    cause: Cause
    gain: float
    sure: float


def _by_spectrum(bench: Bench, cause: Cause) -> _Colour:
    best = state(bench, cause).cause
    likelihood, name = likelihood_of(bench, best), best.kind.parameters[0].name
    colours = np.linspace(0.0, best.values[name], _COLOURS)
    heights = np.array([likelihood({**best.values, name: float(c)}) for c in colours])
    healthy = heights - 0.5 * len(cause.places) * (colours / LEAST_COLOUR) ** 2
    gain, sure = heights[-1] - heights[0], heights[-1] - np.max(healthy)
    return _Colour(best, float(gain), float(sure))

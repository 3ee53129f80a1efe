"""Whether what passes for noise is noise of its places: a step, a moment, noise they share or not.

What is in no library is often told as the noise that has as much power as it: a reading that jumps
once as one that walks, a crate whose BPMs are noisy each by itself as one that hears a noise.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_spectra import MOST_PLACES, places_struck
from orbitfb.diagnose.surprise import surprise
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix

_OCCAM = 2.0
"""What the size of a step or of another noise costs [nats]."""
_FEWEST = 20
"""Rows that have a level of their own, at least."""
_SIZES = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 37)])
"""Variances of noise that are tried, in units of the floor's as its places see it."""


def otherwise(bench: Bench, cause: Cause, gain: float) -> Iterator[tuple[str, float]]:
    """Try what else than noise of its places a cause could be.

    Args:
        bench: The record under all causes.
        cause: Noise, one of them.
        gain: Of the noise, with what healthy noise may explain of it [nats].

    Yields:
        A course in words, and what it gains over the noise, less the price of the choice [nats].
    """
    kind = cause.kind
    if not isinstance(kind, NoiseKind) or kind.rare:
        return
    places = places_struck(bench, cause)
    if not 0 < len(places) <= MOST_PLACES:
        yield "all in a single row", _in_one_row(bench.white, bench, cause)
        return
    patterns = kind.patterns(bench.record.layout)[:, list(places)]
    own = bench.white @ _seen(bench, patterns)[0]
    yield "all in a single row", _in_one_row(own, bench, cause)
    yield "as a step that stays", _as_a_step(bench, patterns) - gain
    if not kind.lag:
        yield from _shared(bench, cause, patterns)


def _seen(bench: Bench, patterns: Matrix) -> tuple[Matrix, Matrix]:
    """Directions among the modes that see patterns (n, k), (n, k'), and these along them."""
    modes = bench.floor.modes.directions.T @ patterns
    return np.linalg.qr(modes / np.sqrt(bench.floor.innovation_variance)[:, None])


def _in_one_row(white: Matrix, bench: Bench, cause: Cause) -> float:
    """What sets the loudest row (k,) apart from the others of its part of the record [nats]."""
    rows = np.arange(len(bench.record))
    counted = ~bench.record.starts
    top = 0.0
    for part in (counted & (rows < cause.onset), counted & (rows >= cause.onset)):
        if part.sum() >= _FEWEST:
            squares, count = np.sum(white[part] ** 2, axis=1), white.shape[1]
            level = float(np.median(squares)) / float(chi2.median(count))
            height = surprise(float(squares.max()) / level, count)
            top = max(top, height - float(np.log(part.sum())))
    return top - _OCCAM


def _as_a_step(bench: Bench, patterns: Matrix) -> float:
    """Gain of a single step of one of some patterns (n, P), beside a floor of its own [nats].

    The floor of a record with a step in it has taken a share of it.
    """
    floor, record = bench.floor, bench.record
    shapes = floor.modes.directions.T @ patterns
    kept = 1.0 - floor.gains
    known = (1.0 / (floor.innovation_variance * (1.0 - kept**2))) @ shapes**2
    pull = np.cumsum((bench.slope @ patterns)[::-1], axis=0)[::-1][1:]
    heights = 0.5 * pull**2 / np.maximum(known, 1e-300)
    row, which = np.unravel_index(int(np.argmax(heights)), heights.shape)
    moved = np.zeros_like(record.readings)
    moved[int(row) + 1 :] = pull[row, which] / known[which] * patterns[:, which]
    told = floor if bench.told_floor else None
    without = replace(record, readings=record.readings - moved)
    still = Bench(without, bench.causes, told, floor.modes)
    gain = still.full_log_likelihood - bench.full_log_likelihood
    choice = float(np.log(pull.size)) + _OCCAM
    return max(float(heights[row, which]), gain) - choice


def _shared(bench: Bench, cause: Cause, patterns: Matrix) -> Iterator[tuple[str, float]]:
    """Ask whether BPMs that are noisy by themselves have one noise, or the other way round."""
    heard = np.flatnonzero(np.any(patterns != 0.0, axis=1))
    if not 1 < len(heard) <= MOST_PLACES:
        return
    rows = ~bench.record.starts & (np.arange(len(bench.record)) >= cause.onset)
    basis, seen = _seen(bench, np.eye(len(patterns))[:, heard])
    own = bench.white[rows] @ basis
    law = patterns[heard] @ patterns[heard].T
    unit = np.trace(seen @ law @ seen.T)
    others = {
        "as noise of each BPM by itself": np.diag(np.diag(law)),
        "as one noise of all its BPMs": np.outer(*2 * (patterns[heard].sum(axis=1),)),
    }
    by_law = _best(own, seen @ law @ seen.T / unit, None)
    for words, other in others.items():
        if not np.allclose(other, law, atol=1e-9 * np.abs(law).max()):
            height = _best(own, seen @ law @ seen.T / unit, seen @ other @ seen.T / unit)
            yield words, height - by_law - _OCCAM


def _best(rows: Matrix, law: Matrix, other: Matrix | None) -> float:
    """Best log-likelihood of rows (N, k) of white noise and one or two more, of unknown sizes."""
    spreads = np.eye(len(law)) + _SIZES[:, None, None, None] * law
    if other is not None:
        spreads = spreads + _SIZES[:, None, None] * other
    found = rows.T @ rows / len(rows)
    misfit = np.einsum("...ij,ji->...", np.linalg.inv(spreads), found)
    return -0.5 * len(rows) * float(np.min(np.linalg.slogdet(spreads)[1] + misfit))

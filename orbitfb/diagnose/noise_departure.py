"""Whether noise is the noise that its law says: its bits, its colour, its lines, its course."""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import chi2

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bits import silent_bit
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_otherwise import otherwise
from orbitfb.diagnose.noise_spectra import MOST_PLACES, SHORTEST, Spectra, places_struck
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix

_FEW_BPMS = 6
"""BPMs whose single bits are looked at."""
_COLOURS = 8
"""Cosines over the spectrum: noise of as many ticks' memory."""
_BLOCKS = 12
"""Parts of a record that may differ in their noise."""
_SHORTEST_BLOCK = 20
"""Rows of the shortest of them."""
_LAGS = range(1, 51)
"""Rows over which noise may echo."""
_CHANCE = 0.99
"""Share of noise that is always the same whose parts differ no more."""
_LEVELS = (2, 4, 8)
"""Ranges of another channel."""
_ALIKE = 1e-6
"""Part of the information on offsets below which they are alike."""
_OCCAM = 2.0
"""What the size of a colour or of a line costs [nats]."""


def noise_laws(bench: Bench, cause: Cause, gain: float) -> Iterator[tuple[str, float]]:
    """Try what else could make the noise of a cause's devices.

    Args:
        bench: The record under all causes.
        cause: Noise, one of them.
        gain: Of the noise, with what healthy noise may explain of it [nats].

    Yields:
        A course in words, and what it gains, less the price of the choice [nats].
    """
    if isinstance(cause.kind, NoiseKind):
        yield from _bits(bench, cause)
        yield from _spectrum(bench, cause)
        if not cause.kind.rare:
            yield from _blocks(bench, cause)
            yield from _offsets(bench, cause, gain)
            yield from otherwise(bench, cause, gain)


def _offsets(bench: Bench, cause: Cause, gain: float) -> Iterator[tuple[str, float]]:
    """Ask whether offsets that go with another channel explain more than any noise does.

    A range that is switched, a magnet that is moved: an offset of its own for every level.
    """
    kind = cause.kind
    places = places_struck(bench, cause)
    if not isinstance(kind, NoiseKind) or not 0 < len(places) <= _FEW_BPMS:
        return
    patterns = kind.patterns(bench.record.layout)[:, list(places)]
    for name, channel in bench.record.auxiliary.items():
        if not np.ptp(channel) > 0.0:  # still, or not known throughout
            continue
        for count in _LEVELS:
            level = np.minimum((channel - channel.min()) / np.ptp(channel) * count, count - 1)
            steps = [level.astype(int) == number for number in range(1, count)]
            pull, known = _of_steps(bench, [step for step in steps if step.any()], patterns)
            height = 0.5 * float(pull @ np.linalg.lstsq(known, pull, rcond=_ALIKE)[0])
            price = _OCCAM * len(pull) + float(np.log(len(bench.record.auxiliary) * len(_LEVELS)))
            yield f"as offsets that go with {name}, in {count} ranges", height - price - gain


def _of_steps(bench: Bench, steps: Sequence[Mask], patterns: Matrix) -> tuple[Vector, Matrix]:
    """Score of offsets of P patterns (n, P) in S sets of rows, (S P,), and the information."""
    floor, every = bench.floor, np.ones(len(patterns))
    orbits = (floor.to_bpms(np.outer(step, every)) for step in steps)
    courses = [floor.whiten(orbit, bench.record.starts) for orbit in orbits]
    shapes = floor.modes.directions.T @ patterns
    pull = [np.sum(bench.white * course, axis=0) @ shapes for course in courses]
    known = [[shapes.T * np.sum(a * b, axis=0) @ shapes for b in courses] for a in courses]
    return np.concatenate(pull), np.block(known)


def _bits(bench: Bench, cause: Cause) -> Iterator[tuple[str, float]]:
    """Look for a converter that makes what passes for more noise of a few BPMs."""
    kind = cause.kind
    assert isinstance(kind, NoiseKind)  # noqa: S101
    patterns = kind.patterns(bench.record.layout)[:, list(cause.places)]
    single = np.all(np.count_nonzero(patterns, axis=0) == 1)
    if kind.target == "bpm" and single and not kind.lag and len(cause.places) <= _FEW_BPMS:
        for place in np.argmax(patterns != 0.0, axis=0):
            bit, nats = silent_bit(bench.record.readings[cause.onset :, place])
            name = bench.record.layout.bpms.label(place)
            yield f"as a converter whose bit of {bit * 1e6:.3g} µm never changes at {name}", nats


def _spectrum(bench: Bench, cause: Cause) -> Iterator[tuple[str, float]]:
    """Look for another colour, or a line, in the noise of the cause's places.

    What the lines of the spectrum (P. Whittle, Ark. Mat. 2 (1953) 423) have too much is compared
    with cosines over the band, by the score's square, and with one line alone.
    """
    places = places_struck(bench, cause)
    if not 0 < len(places) <= MOST_PLACES or len(bench.record) - cause.onset < 2 * SHORTEST:
        return
    spectra = Spectra(bench, cause, slice(cause.onset, None))
    spectra.profile(cause.values)
    scores, known = np.zeros(_COLOURS), np.zeros(_COLOURS)
    top, where, lines = 0.0, 0.0, 0
    for surplus, weight in spectra.surplus(cause.values):
        count, members = surplus.shape
        share = (np.arange(count) + 1.0) / (count + 1.0)
        waves = np.cos(np.pi * np.outer(np.arange(1, _COLOURS + 1), share))
        course = surplus.sum(axis=1)
        scores += weight * (waves @ course)
        known += weight * members * np.sum(waves**2, axis=1)
        lines += count
        best = int(np.argmax(course))
        height = weight * _line(float(course[best]) / members, members)
        if height > top:
            top, where = height, 0.5 * share[best] / bench.record.layout.period
    if not lines:
        return
    colours = 0.5 * scores**2 / known
    ticks = int(np.argmax(colours)) + 1
    price = float(np.log(_COLOURS)) + _OCCAM
    yield f"with an echo after {ticks} tick{'s' * (ticks > 1)}", float(colours[ticks - 1]) - price
    yield f"as a line at {where:.3g} Hz", top - float(np.log(lines)) - _OCCAM
    turns = spectra.alternating(cause.values) / len(places)
    height = sum(0.5 * _line(float(turn), len(places)) for turn in turns)
    yield "as an offset that alternates from tick to tick", height - _OCCAM


def _blocks(bench: Bench, cause: Cause) -> Iterator[tuple[str, float]]:
    """Ask whether every part of the record has as much of it, each by its own variance."""
    places, kind = places_struck(bench, cause), cause.kind
    rows = np.flatnonzero(~bench.record.starts)
    rows = rows[rows >= cause.onset]
    if not 0 < len(places) <= MOST_PLACES or len(rows) < _BLOCKS * _SHORTEST_BLOCK:
        return
    assert isinstance(kind, NoiseKind)  # noqa: S101
    seen = bench.floor.modes.directions.T @ kind.patterns(bench.record.layout)[:, list(places)]
    seen /= np.sqrt(bench.floor.innovation_variance)[:, None]
    course = bench.white[rows] @ (seen / np.linalg.norm(seen, axis=0))
    squares = np.mean(course**2, axis=1)
    parts = np.array_split(squares, _BLOCKS)
    surplus = sum(len(part) * np.log(np.mean(squares) / np.mean(part)) for part in parts)
    # Rows that are alike count once (M. S. Bartlett, Nature 161 (1948) 686).
    echoes = [np.sum(course[lag:] * course[:-lag]) / np.sum(course**2) for lag in _LAGS]
    alike = 1.0 + 2.0 * float(np.sum(np.square(echoes)))
    nats = 0.5 * len(places) * float(surplus) / alike
    yield "as noise that comes and goes", nats - 0.5 * float(chi2.ppf(_CHANCE, _BLOCKS - 1))


def _line(surplus: float, members: int) -> float:
    """Gain of a line's own size over the spectrum's, for some places alike [nats]."""
    return members * (surplus - float(np.log1p(surplus))) if surplus > 0.0 else 0.0

"""Scan what has no grid of places: the whole ring, a line of the spectrum."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import (
    FIRST_ONSET,
    KEPT,
    LAST_ONSET,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.explain import Cause, added
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix

_ONSETS_TRIED = 4
"""Onsets at which the information on an effect of the whole ring is computed."""
_ENDS = (0.5, 0.25, 0.125)
"""Ends of a record in which a line that begins late is looked for."""
_SHORTEST_LINE = 64
"""Rows of the shortest of them."""
_FINER = 4
"""Lines of the spectrum per line that the length of the record resolves."""


def of_ring(bench: Bench, scoring: Scoring, kind: RingKind | ActuatorKind) -> Iterator[Candidate]:
    """Try an effect on the whole ring, from the beginning and from every row on.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
    """
    for values in kind.grid(bench.record):
        if isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, bench.record) - bench.currents
            change = moved @ bench.record.layout.response.T
        else:
            change = kind.deflect(values, bench.record, bench.currents, bench.orbit)
        # What acts on the whole ring acts much like healthy errors, which have what they can.
        info = np.array([bench.information(change)])
        strength, gain = best_strength(kind, scoring.whole(change), info)
        if gain[0] > 0:
            scaled = sized(kind, values, float(strength[0]))
            yield Candidate(Cause(kind, (), scaled), float(gain[0]), 1.0)
        if kind.sudden and not kind.grows:
            yield from _ring_onset(bench, scoring, kind, values, change)


def of_families(bench: Bench, scoring: Scoring, kind: SourceKind) -> Iterator[Candidate]:
    """Try the sets of places that an effect may strike together, from the beginning on.

    Args:
        bench: The record under the causes so far.
        scoring: On that bench.
        kind: The effect.
    """
    families = kind.families(bench.record.layout)
    for values in kind.grid(bench.record):
        for name, places in families.items():
            cause = Cause(kind, tuple(places.tolist()), values)
            change = added(bench.record, cause, bench.currents, bench.orbit)
            # Many places at once act much like healthy errors, which have what they can.
            info = np.array([bench.information(change)])
            strength, gain = best_strength(kind, scoring.whole(change), info)
            if gain[0] > 0:
                scaled = replace(cause, values=sized(kind, values, float(strength[0])))
                yield Candidate(scaled, float(gain[0]), float(len(families)), name)


def _ring_onset(
    bench: Bench, scoring: Scoring, kind: RingKind | ActuatorKind, values: Values, change: Matrix
) -> Iterator[Candidate]:
    """Try every row as the beginning of an effect on the whole ring: no healthy error begins."""
    rows = len(change)
    score = np.cumsum(np.sum(bench.slope * change, axis=1)[::-1])[::-1]
    tried = np.linspace(0.1, 0.9, _ONSETS_TRIED) * rows
    info = [scoring.seen(_from(change, int(row))) for row in tried]
    strength, gain = best_strength(kind, score, np.interp(np.arange(rows), tried, info))
    gain[:FIRST_ONSET] = 0.0
    gain[rows - LAST_ONSET :] = 0.0
    best = int(np.argmax(gain))
    if gain[best] > 0:
        scaled = sized(kind, values, float(strength[best]))
        yield Candidate(Cause(kind, (), scaled, best), float(gain[best]), float(rows))


def _from(change: Matrix, row: int) -> Matrix:
    later = change.copy()
    later[:row] = 0.0
    return later


def periodic(bench: Bench, kind: SourceKind) -> Iterator[Candidate]:
    """Find the line of one source, in the whole record and in its end.

    Args:
        bench: The record under the causes so far.
        kind: The effect.
    """
    longest = max(bench.record.stretches, key=lambda part: part.stop - part.start)
    rows = longest.stop - longest.start
    for share in (1.0, *(_ENDS if kind.sudden else ())):
        begin = longest.stop - round(share * rows)
        if longest.stop - begin >= _SHORTEST_LINE:
            yield from _lines(bench, kind, slice(begin, longest.stop), rows)


def _lines(bench: Bench, kind: SourceKind, part: slice, every: int) -> Iterator[Candidate]:
    """Best lines of some rows: the Fourier transform of the score has all frequencies.

    Args:
        bench: The record under the causes so far.
        kind: The effect.
        part: Rows in which the line is on.
        every: Rows at which it may have begun.
    """
    record, rows = bench.record, part.stop - part.start
    patterns = kind.patterns(record.layout)
    padded = _FINER * rows
    score = np.fft.rfft(bench.slope[part] @ patterns, padded, axis=0)
    frequency = np.fft.rfftfreq(padded)
    feedback = 1.0 - bench.floor.gains
    turn = np.exp(-2j * np.pi * frequency)[:, None]
    response = np.abs((1.0 - turn) / (1.0 - feedback * turn)) ** 2
    weight = response / bench.floor.innovation_variance
    info = weight @ (bench.floor.modes.directions.T @ patterns) ** 2 * (rows / 2.0)
    info[: 2 * _FINER] = np.inf  # fewer than two periods are a drift
    gain = 0.5 * np.abs(score) ** 2 / info
    late = rows < every
    for flat in np.argpartition(gain, -KEPT, axis=None)[-KEPT:]:
        line, place = np.unravel_index(int(flat), gain.shape)
        size = score[line, place] / info[line, place]
        angle = 2 * np.pi * frequency[line] * part.start
        size *= np.exp(1j * angle)  # the course is counted from the first row of the record
        values = {
            "frequency": float(frequency[line] / record.layout.period),
            "cosine": float(size.real),
            "sine": float(-size.imag),
        }
        cause = Cause(kind, (int(place),), values, part.start if late else 0)
        choices = float(gain.size) / _FINER * (every if late else 1)
        yield Candidate(cause, float(gain[line, place]), choices)

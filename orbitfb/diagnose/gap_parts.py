"""Parts of the gap by band, window and bin, each with its interval."""

from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.answer_parts import Binning, GapPiece
from orbitfb.diagnose.blocks import Draws, interval
from orbitfb.diagnose.surplus import Surplus
from orbitfb.records.record import Record

_WINDOWS = 10
_SLOWEST = 1.0 / 256.0
_SIZES = 4

_Bin = tuple[str, Mask, float | None, float | None]


def band_edges() -> Vector:
    """Octaves up to half a cycle per tick; the first band has all that is slower."""
    octaves = np.geomspace(_SLOWEST, 0.5, 8)
    return np.array([-1.0, *octaves[:-1], 1.0])


def bands(whole: Surplus, draws: Draws, period: float, ticks: int) -> tuple[GapPiece, ...]:
    """Part of every octave of frequency [Hz]."""
    edges = band_edges()
    pieces: list[GapPiece] = []
    for index, band in enumerate(whole.by_frequency(edges)):
        by_row = band.sum(axis=1)
        low = max(edges[index], 0.0) / period
        high = min(edges[index + 1], 0.5) / period
        pieces.append(_piece(f"{low:.3g}-{high:.3g} Hz", low, high, by_row, draws, ticks))
    return tuple(pieces)


def _piece(
    label: str, start: float | None, stop: float | None, by_row: Vector, draws: Draws, ticks: int
) -> GapPiece:
    """A part whose value is the sum over all rows; the draws are moved onto it."""
    drawn = draws.means(by_row)
    drawn += by_row.sum() / ticks - drawn[0]
    found = interval(drawn)
    return GapPiece(
        label=label,
        start=start,
        stop=stop,
        nats_per_tick=found.value,
        low=found.low,
        high=found.high,
        resolved=found.resolved or bool(np.quantile(drawn[1:], 0.995) < 0.0),
    )


def windows(by_row: Vector, draws: Draws, time: Vector, period: float) -> tuple[GapPiece, ...]:
    """Part of every tenth of the record [s]."""
    edges = np.linspace(0, len(by_row), min(_WINDOWS, len(by_row)) + 1).astype(int)
    ticks = max(int(draws.counted.sum()), 1)
    pieces: list[GapPiece] = []
    for number, (begin, end) in enumerate(pairwise(edges)):
        own = np.zeros_like(by_row)
        own[begin:end] = by_row[begin:end]
        start, stop = float(time[begin]), float(time[end - 1]) + period
        pieces.append(_piece(f"window {number + 1}", start, stop, own, draws, ticks))
    return tuple(pieces)


def bins(by_row: Vector, draws: Draws, record: Record) -> tuple[Binning, ...]:
    """Parts by size, direction and reversal of the change of the setpoints."""
    change = np.zeros_like(record.setpoints)
    change[1:] = record.setpoints[1:] - record.setpoints[:-1]
    change[record.starts] = 0.0
    before = np.zeros_like(change)
    before[1:] = change[:-1]
    strongest = np.linalg.svd(record.layout.response)[2][0]
    along = change @ strongest
    turn = np.sum(change * before, axis=1)
    size = 1e3 * np.sqrt(np.mean(change**2, axis=1))
    edges = np.quantile(size, np.linspace(0.0, 1.0, _SIZES + 1))
    where = np.clip(np.searchsorted(edges, size, side="right") - 1, 0, _SIZES - 1)
    sizes: list[_Bin] = [
        (f"{edges[k]:.3g}-{edges[k + 1]:.3g}", where == k, float(edges[k]), float(edges[k + 1]))
        for k in range(_SIZES)
    ]
    return (
        _binning("size of the change of the setpoints, rms", "mA", sizes, by_row, draws),
        _binning(
            "direction of the change along the strongest mode",
            "",
            [("up", along > 0, None, None), ("down", along <= 0, None, None)],
            by_row,
            draws,
        ),
        _binning(
            "change against the one before",
            "",
            [("reversed", turn < 0, None, None), ("same direction", turn >= 0, None, None)],
            by_row,
            draws,
        ),
    )


def _binning(
    title: str,
    unit: str,
    parts: list[_Bin],
    by_row: Vector,
    draws: Draws,
) -> Binning:
    ticks = max(int(draws.counted.sum()), 1)
    return Binning(
        title=title,
        unit=unit,
        pieces=tuple(
            _piece(label, start, stop, np.where(chosen, by_row, 0.0), draws, ticks)
            for label, chosen, start, stop in parts
        ),
    )

"""A converter one of whose bits never changes: half of all readings do not occur.

With bit b always 0 the readings lie in every other interval of length b only: their phases with
the period 2 b fill half a turn. Noise of any shape fills all of it, so every reading in the right
half is worth log 2.
"""

import numpy as np

from orbitfb.core.signals import Vector

_BINS = 32
_HALF = 14
"""Neighbouring bins that must be empty: half a turn, less the edges."""
_FEW = 0.005
"""Share of the readings that may lie there all the same."""
_FILLED = 0.25
"""Share of an even filling that the other half has in each of `_HALF` bins: rounded readings have
few phases, and fill neither half."""
_SMEAR = 0.05
"""Part of a turn by which the phases of a period may be off at the end of the range."""
_DISTINCT = 0.5
"""Share of readings that differ from all others: fewer are rounded, with phases of their own."""
_LEAST_TURNS, _MOST_TURNS = 10.0, 500.0
"""Periods in the range of the readings: fewer are a histogram and no phase, more are noise."""
_CHUNK = 256


def silent_bit(readings: Vector) -> tuple[float, float]:
    """Look for a bit that never changes.

    Args:
        readings: Of one BPM, shape (N,) [m].

    Returns:
        Its size [m] and what it is worth, less the price of the choice [nats]; 0 and 0 where
        there is none.
    """
    own = readings[np.isfinite(readings)]
    if len(own) < 2 * _BINS or len(np.unique(own)) < _DISTINCT * len(own):
        return 0.0, 0.0
    own = own - own.min()
    span = float(np.subtract(*np.quantile(own, [0.99, 0.01])))
    if span <= 0.0:
        return 0.0, 0.0
    rates = np.arange(_LEAST_TURNS, _MOST_TURNS, _SMEAR) / span
    best, bit = 1.0, 0.0
    for begin in range(0, len(rates), _CHUNK):
        some = rates[begin : begin + _CHUNK]
        bins = ((own[:, None] * some) % 1.0 * _BINS).astype(np.intp)
        flat = (bins + _BINS * np.arange(len(some))).ravel()
        counts = np.bincount(flat, minlength=_BINS * len(some)).reshape(len(some), _BINS)
        turned = np.cumsum(np.concatenate([counts, counts[:, :_HALF]], axis=1), axis=1)
        share = (turned[:, _HALF:] - turned[:, :-_HALF]).min(axis=1) / len(own)
        filled = np.sum(counts > _FILLED * len(own) / _BINS, axis=1)
        share[filled < _HALF] = 1.0
        least = int(np.argmin(share))
        if share[least] < best:
            best, bit = float(share[least]), 0.5 / float(some[least])
    nats = len(own) * np.log(2.0) - np.log(len(rates) * _BINS)
    return (bit, float(nats)) if best <= _FEW and nats > 0.0 else (0.0, 0.0)

"""Many correctors at once: play the waveform at two sizes, demodulate what the orbits showed."""

from collections.abc import Callable, Sequence

import numpy as np

from orbitfb.core.errors import MeasurementError
from orbitfb.core.signals import Mask, Reading, Vector
from orbitfb.measure.column import Column
from orbitfb.measure.mover import Mover
from orbitfb.measure.multisine import Demodulated, Multisine, demodulate
from orbitfb.measure.settings import MeasureSettings
from orbitfb.measure.watch import Watch

SIZES = (0.5, 1.0)
"""Sizes of the passes; what differs between them is not linear."""
_NEIGHBOURS = 9
"""Correctors nearest in frequency whose differences tell the noise there."""
_SIGNIFICANT = 12.0
"""Ratio of mean squares from which a difference between the passes is not noise."""
_LATEST = 6
_SHOWN = 0.1
"""How far a readback may be from the level in force, parts of the amplitude."""
_MOST = 0.9
"""Part of the correctors that must show one sample."""
_MOST_LOST = 0.3
_LEAD = 10
"""Ticks in which the waveform grows from nothing before a pass."""


def orbits_at_once(wave: Multisine) -> int:
    """Count the orbits of a group that plays a waveform.

    Args:
        wave: The waveform.
    """
    return len(SIZES) * (wave.ticks + _LEAD)


def measure_at_once(
    correctors: Sequence[int],
    amplitudes: Vector,
    wave: Multisine,
    mover: Mover,
    watch: Watch,
    settings: MeasureSettings,
    played: Callable[[float], None] = lambda _: None,
) -> list[Column]:
    """Measure several columns at once; the correctors are left where the waveform ends.

    Args:
        correctors: Their indices.
        amplitudes: Of the larger pass, shape (k,) [A].
        wave: A frequency for each.
        mover: Moves them.
        watch: Gives orbits.
        settings: How long to let settle.
        played: Told after each orbit which share of the passes is over.

    Raises:
        MeasurementError: It must be given up.
        MachineError: The machine does not do what it should.
    """
    count = len(SIZES)

    def told(before: int) -> Callable[[float], None]:
        return lambda share: played((before + share) / count)

    passes = [
        _one_pass(correctors, amplitudes * size, wave, mover, watch, told(before))
        for before, size in enumerate(SIZES)
    ]
    shown = [demodulate(wave, samples, orbits) for samples, orbits, _, _ in passes]
    samples, _, readbacks, time = passes[-1]
    following = _following(wave, samples, readbacks)
    half, full = (each.response / size for each, size in zip(shown, SIZES, strict=True))
    doubt = np.hypot(shown[0].sigma / SIZES[0], shown[1].sigma / SIZES[1])
    apart, expected = _differences(half, full, doubt, wave)
    size = np.nanmean(full**2, axis=0)
    significant = apart > _SIGNIFICANT * expected
    bent = np.where(significant, np.sqrt(np.maximum(apart - expected, 0.0) / size), 0.0)
    colour = np.sqrt(expected / np.nanmean(doubt**2, axis=0))
    return [
        Column(
            full[:, k] / amplitude,
            shown[-1].sigma[:, k] * colour[k] / amplitude,
            shown[-1].noise,
            float(bent[k]),
            float(following[k]) / amplitude,
            float(shown[-1].phase[k]),
            float(amplitude),
            time,
        )
        for k, amplitude in enumerate(amplitudes)
    ]


def _one_pass(
    correctors: Sequence[int],
    amplitudes: Vector,
    wave: Multisine,
    mover: Mover,
    watch: Watch,
    told: Callable[[float], None],
) -> tuple[Vector, Vector, Vector, float]:
    """Play the waveform once: samples in force, orbits, readbacks, time of the last one."""
    samples: list[float] = []
    readings: list[Reading] = []
    for sample in range(-_LEAD, wave.ticks):
        grown = min(1.0, (sample + _LEAD + 1) / _LEAD)
        level = wave.levels(np.array([sample]))[0]
        mover.offset(correctors, amplitudes * level * grown)
        reading = watch.orbit()
        told((sample + _LEAD + 1) / (wave.ticks + _LEAD))
        if sample >= 0:
            samples.append(sample)
            readings.append(reading)
    orbits = np.array([watch.position(reading) for reading in readings])
    readbacks = np.array([reading.readback[list(correctors)] for reading in readings])
    shown = (readbacks - mover.base[list(correctors)]) / amplitudes
    in_force, known = _in_force(wave, np.array(samples), shown)
    return in_force[known], orbits[known], readbacks[known], readings[-1].orbit.time


def _in_force(wave: Multisine, written: Vector, shown: Vector) -> tuple[Vector, Mask]:
    """Find out by the readbacks which sample was in force at every orbit.

    A write may come a tick too late, or in the middle of a tick. Where most readbacks do not
    show the waveform at all (there are none, or slow ones) the sample written last is taken.

    Args:
        wave: The waveform.
        written: Sample written last before every orbit, shape (K,).
        shown: Levels that the readbacks show, shape (K, k).

    Returns:
        Samples, shape (K,), and at which orbits they are known, shape (K,).
    """
    late = np.arange(_LATEST + 1)
    known = np.isfinite(shown).all(axis=0)
    if not known.any():
        return written, np.ones(len(written), dtype=np.bool_)
    apart = np.stack([np.abs(shown - wave.levels(written - ticks))[:, known] for ticks in late])
    missed = np.median(apart, axis=2)
    best = missed.argmin(axis=0)
    agree = missed.min(axis=0) < _SHOWN
    agree &= np.quantile(apart, _MOST, axis=2)[best, np.arange(len(written))] < _SHOWN
    if np.mean(agree) < 1.0 - _MOST_LOST:
        return written, np.ones(len(written), dtype=np.bool_)
    return written - late[best], agree


def _following(wave: Multisine, samples: Vector, readbacks: Vector) -> Vector:
    """Give the size of every readback at its own frequency, shape (k,) [A]; NaN: not known."""
    k = len(wave.bins)
    following = np.full(k, np.nan)
    known = np.isfinite(readbacks).all(axis=0)
    if not known.any():
        return following
    try:
        shown: Demodulated = demodulate(wave, samples, readbacks[:, known])
    except MeasurementError:  # readbacks that do not come in step say nothing
        return following
    following[known] = shown.response[np.arange(known.sum()), np.flatnonzero(known)]
    return following


def _differences(
    half: Vector, full: Vector, doubt: Vector, wave: Multisine
) -> tuple[Vector, Vector]:
    """Compare two passes, and say how far noise alone would take them apart.

    A moving orbit is louder at low frequencies, so the noise is that of the neighbours in
    frequency; of too few correctors it is taken as white.

    Args:
        half: Responses of one pass, shape (n, k) [m]; NaN where not known.
        full: Of the other.
        doubt: Standard deviation of their difference, were the noise white, shape (n, k) [m].
        wave: Has the frequencies.

    Returns:
        Mean square difference of every column and the expected one, shape (k,) [m²].
    """
    apart = np.nanmean((full - half) ** 2, axis=0)
    white = np.nanmean(doubt**2, axis=0)
    order = np.argsort(wave.bins)
    local = np.empty_like(apart)
    for rank, k in enumerate(order):
        first = max(0, min(rank - _NEIGHBOURS // 2, len(order) - _NEIGHBOURS))
        local[k] = np.median(apart[order[first : first + _NEIGHBOURS]])
    return apart, local if len(order) >= _NEIGHBOURS else white

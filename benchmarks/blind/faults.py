"""Effects of the small rings of many kinds, each made of random numbers."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind.fodo import PERIOD, WARM, Effect

Array = NDArray[np.float64]
Rng = np.random.Generator


def _factors(rng: Rng, count: int) -> tuple[NDArray[np.intp], Array]:
    places = np.sort(rng.choice(count, 2, replace=False))
    factors = np.ones(count)
    factors[places] += rng.choice([-1, 1], 2) * rng.uniform(0.15, 0.3, 2)
    return places, factors


def _bpm_gain(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    places, factors = _factors(rng, bpms)
    return Effect("bpm_gain", bpms=places, read=lambda tick, readings: readings * factors)


def _corrector_gain(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    places, factors = _factors(rng, correctors)
    return Effect(
        "corrector_calibration", correctors=places, act=lambda tick, currents: currents * factors
    )


def _lag(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    places = np.sort(rng.choice(correctors, 2, replace=False))
    left, there = float(np.exp(-PERIOD / rng.uniform(0.06, 0.12))), np.zeros(2)

    def act(tick: int, currents: Array) -> Array:
        there[:] = currents[places] + (there - currents[places]) * left
        slow = currents.copy()
        slow[places] = there
        return slow

    return Effect("corrector_lag", correctors=places, act=act)


def _delay(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    last = np.zeros(correctors)

    def act(tick: int, currents: Array) -> Array:
        late = last.copy()
        last[:] = currents
        return late

    return Effect("transport_delay", act=act)


def _held(place: int, onset: int) -> Callable[[int, Array], Array]:
    kept = np.zeros(1)

    def hold(tick: int, values: Array) -> Array:
        if tick <= onset:
            kept[0] = values[place]
        standing = values.copy()
        standing[place] = kept[0]
        return standing

    return hold


def _stuck(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    place, onset = int(rng.integers(correctors)), WARM + int(rng.uniform(0.3, 0.5) * rows)
    return Effect("corrector_stuck", correctors=np.array([place]), act=_held(place, onset))


def _frozen(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    place, onset = int(rng.integers(bpms)), WARM + int(rng.uniform(0.3, 0.5) * rows)
    return Effect("bpm_dead", bpms=np.array([place]), read=_held(place, onset))


def _play(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    half, there = rng.uniform(0.01, 0.02), np.zeros(correctors)

    def act(tick: int, currents: Array) -> Array:
        there[:] = np.clip(there, currents - half, currents + half)
        return there.copy()

    return Effect("corrector_backlash", act=act)


def _onset(rng: Rng, rows: int) -> int:
    return WARM + int(rng.uniform(0.3, 0.5) * rows)


def _trip(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    place, onset = int(rng.integers(correctors)), _onset(rng, rows)

    def act(tick: int, currents: Array) -> Array:
        left = currents.copy()
        left[place] *= tick <= onset
        return left

    return Effect("corrector_trip", correctors=np.array([place]), act=act)


def _crate(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    """Four neighbours are switched on again, each with another offset."""
    places, onset = int(rng.integers(bpms - 4)) + np.arange(4), _onset(rng, rows)
    jumps = np.zeros(bpms)
    jumps[places] = rng.choice([-1.0, 1.0], 4) * rng.uniform(3e-6, 20e-6, 4)
    return Effect("bpm_jump", bpms=places, read=lambda tick, x: x + jumps * (tick > onset))


def _common(rng: Rng, bpms: int, correctors: int, rows: int) -> Effect:
    """Four neighbours have noise in common."""
    places = int(rng.integers(bpms - 4)) + np.arange(4)
    drawn, there = (
        rng.uniform(0.3e-6, 0.6e-6) * rng.standard_normal(WARM + rows + 1),
        np.zeros(bpms),
    )
    there[places] = 1.0
    return Effect("common_noise", bpms=places, read=lambda tick, x: x + drawn[tick] * there)


FAULTS: dict[str, Callable[[Rng, int, int, int], Effect]] = {
    "bpm-gain": _bpm_gain,
    "corrector-gain": _corrector_gain,
    "lag": _lag,
    "delay": _delay,
    "stuck": _stuck,
    "frozen": _frozen,
    "play": _play,
    "trip": _trip,
    "crate": _crate,
    "common-noise": _common,
}
"""Effects, each made of random numbers, BPMs, correctors and rows."""

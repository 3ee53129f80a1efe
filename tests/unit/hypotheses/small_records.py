"""Small records made here: no ring, a response of random numbers, a closed loop with dither."""

from collections.abc import Callable

import numpy as np

from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

BPMS, CORRECTORS, ROWS = 16, 12, 900
NOISE = 0.2e-6
Bent = Callable[[Matrix], Matrix]


def as_it_is(currents: Matrix) -> Matrix:
    return currents


def make_record(
    seed: int,
    currents: Bent = as_it_is,
    sensed: Bent = as_it_is,
    gain: float = 0.4,
    dither: float = 0.02,
) -> Record:
    """A loop of some gain with dither, a walk of random kicks, and white noise."""
    rng = np.random.default_rng(seed)
    response = rng.standard_normal((BPMS, CORRECTORS)) * 1e-5
    inverse = np.linalg.pinv(response)
    kicks = (rng.standard_normal((ROWS, CORRECTORS)) * 1e-3).cumsum(axis=0)
    setpoints = np.zeros((ROWS, CORRECTORS))
    readings = np.zeros((ROWS, BPMS))
    noise = NOISE * rng.standard_normal((ROWS, BPMS))
    for row in range(ROWS):
        acting = currents(setpoints[: row + 1])[-1]
        orbit = response @ (acting + kicks[row])
        readings[row] = sensed(orbit[None])[0] + noise[row]
        if row + 1 < ROWS:
            more = dither * rng.standard_normal(CORRECTORS)
            setpoints[row + 1] = setpoints[row] - gain * inverse @ readings[row] + more
    requested = np.vstack([np.diff(setpoints, axis=0), np.full((1, CORRECTORS), np.nan)])
    layout = Layout(
        Devices(tuple(f"B{i}" for i in range(BPMS)), ("x",) * BPMS, ("",) * BPMS),
        Devices(tuple(f"C{i}" for i in range(CORRECTORS)), ("x",) * CORRECTORS, ("",) * CORRECTORS),
        response,
        0.1,
        None,
    )
    starts = np.zeros(ROWS, dtype=np.bool_)
    starts[0] = True
    return Record(
        layout, 0.1 * np.arange(ROWS), starts, readings, setpoints, requested, None, None, None,
        np.zeros_like(readings, dtype=np.bool_), {}, "made by a test", "",
    )  # fmt: skip


def kinds_for(record: Record) -> list[EffectKind]:
    return [kind for kind in all_effects().values() if not kind.unavailable(record)]

"""Small records made here: no ring, a response of random numbers, a closed loop with dither."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.build import layout_of
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

BPMS, CORRECTORS, ROWS = 16, 12, 900
NOISE = 0.2e-6
Bent = Callable[[Matrix], Matrix]


def as_it_is(currents: Matrix) -> Matrix:
    return currents


def remembered(step: Callable[[Vector, Vector], Vector], first: Vector | None = None) -> Bent:
    """A law with a state θ = step(θ, u), which begins where the first setpoints are.

    It is called with one row more each time, and goes on from the state that it has.

    Args:
        step: From the state and the setpoints, both (m,) [A].
        first: By how much the state is elsewhere at the beginning, (m,) [A].
    """
    state: list[Vector] = []

    def bent(currents: Matrix) -> Matrix:
        if len(currents) == 1:
            state[:] = [currents[0] + (0.0 if first is None else first)]
        state[0] = step(state[0], currents[-1])
        return state[0][None]

    return bent


def lagging(kept: float) -> Bent:
    """Every corrector behind a time constant: of what it lacked this share is left a row later."""
    return remembered(lambda state, row: state + (1.0 - kept) * (row - state))


def make_record(
    seed: int,
    currents: Bent = as_it_is,
    sensed: Bent = as_it_is,
    gain: float = 0.4,
    dither: float = 0.02,
    rows: int = ROWS,
    noise_rms: float = NOISE,
) -> Record:
    """A loop of some gain with dither, a walk of random kicks, and white noise."""
    rng = np.random.default_rng(seed)
    response = rng.standard_normal((BPMS, CORRECTORS)) * 1e-5
    inverse = np.linalg.pinv(response)
    kicks = (rng.standard_normal((rows, CORRECTORS)) * 1e-3).cumsum(axis=0)
    setpoints = np.zeros((rows, CORRECTORS))
    readings = np.zeros((rows, BPMS))
    noise = noise_rms * rng.standard_normal((rows, BPMS))
    for row in range(rows):
        acting = currents(setpoints[: row + 1])[-1]
        orbit = response @ (acting + kicks[row])
        readings[row] = sensed(orbit[None])[0] + noise[row]
        if row + 1 < rows:
            more = dither * rng.standard_normal(CORRECTORS)
            setpoints[row + 1] = setpoints[row] - gain * inverse @ readings[row] + more
    layout = Layout(
        Devices(tuple(f"B{i}" for i in range(BPMS)), ("x",) * BPMS, ("",) * BPMS),
        Devices(tuple(f"C{i}" for i in range(CORRECTORS)), ("x",) * CORRECTORS, ("",) * CORRECTORS),
        response,
        0.1,
        None,
    )
    return recorded(layout, setpoints, readings)


def early(seed: int, share: float) -> Record:
    """A loop whose readings are a little early in half of the rows: the orbit is on its way."""
    rng = np.random.default_rng(seed)

    def step(state: Vector, row: Vector) -> Vector:
        before.append(row)
        return row - max(share * rng.standard_normal(), 0.0) * (row - before[-2])

    before: list[Vector] = [np.zeros(CORRECTORS)]
    return make_record(11, remembered(step))


def kinds_for(record: Record) -> list[EffectKind]:
    return [kind for kind in all_effects().values() if not kind.unavailable(record)]


def every(devices: Devices, step: int) -> Devices:
    return Devices(devices.names[::step], devices.planes[::step], devices.cells[::step])


def some_devices(step: int) -> Layout:
    """Every so many devices of the default ring, all quadrupoles between them."""
    whole = layout_of(Ring.load(), "x", 0.1)
    response = whole.response[::step, ::step]
    return replace(
        whole,
        bpms=every(whole.bpms, step),
        correctors=every(whole.correctors, step),
        response=response,
    )


def recorded(layout: Layout, setpoints: Matrix, readings: Matrix) -> Record:
    requested = np.vstack([np.diff(setpoints, axis=0), np.full_like(setpoints[:1], np.nan)])
    rows = np.arange(len(readings))
    return Record(
        layout, layout.period * rows, rows == 0, readings, setpoints, requested,
        readback=None, dither=None, reference=None, filled=np.zeros(readings.shape, dtype=np.bool_),
        auxiliary={}, source="made here", digest="",
    )  # fmt: skip

"""Make a record: the simulated ring under the linear law, with any effects in it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.build import layout_of
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.records.digest import digest_of
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

RUNAWAY = 5e-3
"""Orbit at which a simulated run ends, as an interlock would end it, rms [m]."""

DEFAULT_PERIOD = 0.1
"""From one orbit to the next when nobody says [s]."""

_SMOOTH_MODES = 20


@dataclass(slots=True, eq=False)
class _Columns:
    """What a run leaves behind, all ticks."""

    readings: Matrix
    setpoints: Matrix
    requested: Matrix
    readback: Matrix
    dither: Matrix
    reference: Matrix


def simulate_record(
    ring: Ring,
    planes: Planes = "x",
    ticks: int = 1500,
    seed: int = 0,
    effects: Sequence[Effect] = (),
    dither: float = 0.0,
    steering: int = 4,
    gain: float = 0.35,
    regularisation: float = 70e-6,
    plant: PlantSettings | None = None,
    response: Matrix | None = None,
    period: float = DEFAULT_PERIOD,
    settle: int = 200,
    steering_rms: float = 10e-6,
    readback: bool = False,
    excitation: Matrix | None = None,
) -> Record:
    """Run the simulated ring in closed loop and record it.

    The reading of a row has the setpoints of the row in force; the change that the law asks for
    after it is in the setpoints of the next row. A run whose orbit passes `RUNAWAY` ends there.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        ticks: Transitions to record; the record has one row more.
        seed: Of every random number.
        effects: Effects beside the plant's own. They see tick 0 at the beginning of `settle`.
        dither: White noise on every setpoint change, rms [A].
        steering: Times that the reference orbit changes during the record.
        gain: Of the loop [1].
        regularisation: Tikhonov λ [m/A].
        plant: Noise, drift, initial orbit; the plant's own defaults when None.
        response: Model that the law and the record's layout use, shape (n, m) [m/A]; that of
            the ring's optics when None. The plant always has the ring's optics.
        period: From one orbit to the next [s].
        settle: Ticks before recording begins, without dither.
        steering_rms: Size of a change of the reference [m].
        readback: Whether the record has the currents of the magnets.
        excitation: Excursion around the setpoints of the feedback at the last rows of the
            record, shape (T, m) [A]; the rows before it are as they were.
    """
    layout = layout_of(ring, planes, period, response)
    policy = SvdPolicy(layout.response, SvdSettings(gain=gain, regularisation=regularisation))
    machine = Plant(ring, planes, plant, seed, effects)
    rows = settle + ticks + 1
    n, m = layout.response.shape
    columns = _Columns(
        readings=np.zeros((rows, n)),
        setpoints=np.zeros((rows, m)),
        requested=np.zeros((rows, m)),
        readback=np.zeros((rows, m)),
        dither=np.zeros((rows, m)),
        reference=_references(layout, rows, settle, steering, steering_rms, seed),
    )
    if dither > 0.0:
        rng = generator(seed, "diagnose dither")
        columns.dither[settle:] = dither * rng.standard_normal((rows - settle, m))
    if excitation is not None:
        last = excitation[-(rows - settle) :]
        columns.dither[rows - len(last) - 1 : rows - 1] += np.diff(last, axis=0, prepend=0.0)
    done = _run(machine, policy.gain_matrix, columns)
    first = settle if done - settle > ticks // 2 else max(0, done - ticks - 1)
    return _record(layout, columns, slice(first, done), readback, bool(columns.dither.any()), seed)


def _run(machine: Plant, gain_matrix: Vector, columns: _Columns) -> int:
    """Let the loop run; say how many rows were made."""
    rows, m = columns.setpoints.shape
    setpoints = np.zeros(m)
    for row in range(rows):
        state = machine.step(setpoints)
        change = columns.dither[row] - gain_matrix @ (state.reading - columns.reference[row])
        columns.readings[row] = state.reading
        columns.setpoints[row] = setpoints
        columns.readback[row] = state.readback
        columns.requested[row] = change
        if np.sqrt(np.mean(state.reading**2)) > RUNAWAY:
            return row + 1
        setpoints = setpoints + change
    return rows


def _references(
    layout: Layout, rows: int, settle: int, steering: int, rms: float, seed: int
) -> Matrix:
    """Change the reference at even distances, by orbits that the correctors can make well."""
    rng = generator(seed, "diagnose steering")
    modes = np.linalg.svd(layout.response, full_matrices=False)[0][:, :_SMOOTH_MODES]
    reference = np.zeros((rows, layout.response.shape[0]))
    for step in range(steering):
        shape = modes @ rng.standard_normal(modes.shape[1])
        at = settle + (rows - settle) * (2 * step + 1) // (2 * steering)
        reference[at:] += shape * (rms / np.sqrt(np.mean(shape**2)))
    return reference


def _record(
    layout: Layout, columns: _Columns, rows: slice, readback: bool, dither: bool, seed: int
) -> Record:
    readings, requested = columns.readings[rows], columns.requested[rows].copy()
    requested[-1] = np.nan
    count = len(readings)
    return Record(
        layout=layout,
        time=np.arange(count, dtype=np.float64) * layout.period,
        starts=np.arange(count) == 0,
        readings=readings,
        setpoints=columns.setpoints[rows],
        requested=requested,
        readback=columns.readback[rows] if readback else None,
        dither=columns.dither[rows] if dither else None,
        reference=columns.reference[rows],
        filled=np.zeros(readings.shape, dtype=np.bool_),
        auxiliary={},
        source=f"simulated ring, seed {seed}",
        digest=digest_of(readings, columns.setpoints[rows]),
    )

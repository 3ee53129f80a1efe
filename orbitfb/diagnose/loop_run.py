"""Let the loop of a record run anew: its model, its law, its floor, and the effects of causes."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from orbitfb.core.signals import Vector
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.loop_law import reference_of
from orbitfb.effects.build import Since
from orbitfb.effects.device_kinds import PairKind
from orbitfb.physics.effect import Effect, generator
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_BROKEN = 1e-2
"""Orbit at which a simulated loop counts as lost [m]."""
_SETTLED = 2
"""Newton steps to the orbit that makes a reading."""
_TRIALS = 20
_PROBE = 1e-9
"""Step that slopes are taken with, and what is left of a reading that is made [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """What the loop is run with.

    Args:
        record: Whose references, dither, first reading and first setpoints every run has.
        floor: The noise.
        law: K, shape (m, n) [A/m].
        effects: Of every run, one list for each.
        seed: Of the noise.
    """

    record: Record
    floor: NoiseFloor
    law: Matrix
    effects: Sequence[Sequence[Effect]]
    seed: int


def effects_of(
    causes: Sequence[Cause], layout: Layout, seed: int, *, onsets: bool
) -> tuple[Effect, ...]:
    """Make causes parts of a simulated ring.

    Args:
        causes: What is to act.
        layout: Devices and model.
        seed: Of their random numbers.
        onsets: Whether they begin where they did; otherwise they are there from the beginning.
    """
    made: list[Effect] = []
    for number, cause in enumerate(causes):
        rng = generator(seed, f"effect {cause.kind.id} {number}")
        effect = cause.kind.simulate(layout, _columns(cause, layout), cause.values, rng)
        late = onsets and cause.onset > 0
        made.append(Since(effect, cause.onset, cause.kind.grows) if late else effect)
    return tuple(made)


def _columns(cause: Cause, layout: Layout) -> Indices:
    places = np.array(cause.places, dtype=np.intp)
    if isinstance(cause.kind, PairKind):
        struck = [column for place in cause.places for column in cause.kind.struck(layout, place)]
        return np.array(struck, dtype=np.intp)
    return places


def run_loop(its: Runs) -> Matrix | None:
    """Simulate the readings of a record.

    Every stretch begins anew, with the setpoints that were in force and the orbit that was read.

    Args:
        its: What to run with.

    Returns:
        Readings less the reference, shape (runs, N, n) [m]; None when a loop is lost.
    """
    record, floor = its.record, its.floor
    reference, response = reference_of(record), record.layout.response
    dither = np.zeros_like(record.setpoints) if record.dither is None else record.dither
    dither = np.where(np.isfinite(dither), dither, 0.0)
    count = len(its.effects)
    rng = generator(its.seed, "diagnose closed loop")
    off = np.zeros((count, *record.readings.shape))
    ground = np.zeros((count, record.readings.shape[1]))
    setpoints = np.zeros((count, record.setpoints.shape[1]))
    for row in range(len(record)):
        if record.starts[row]:
            setpoints[:] = record.setpoints[row]
            for run, effects in enumerate(its.effects):
                ground[run] = _ground(effects, response, record, row)
        else:
            step = rng.standard_normal(ground.shape) * np.sqrt(floor.walk)
            ground += floor.to_bpms(step)
        readings = _read(its.effects, response, setpoints, ground, row)
        readings += np.sqrt(floor.readings) * rng.standard_normal(ground.shape)
        off[:, row] = readings - reference[row]
        if not np.max(np.abs(off[:, row])) < _BROKEN:
            return None
        setpoints = setpoints - off[:, row] @ its.law.T + dither[row]
    return off


def _ground(effects: Sequence[Effect], response: Matrix, record: Record, row: int) -> Vector:
    """Orbit without the correctors that makes the reading of a row, whatever the effects do.

    Newton's method; GMRES solves its linear step by trials alone, as effects only simulate. It
    leaves alone what no orbit can make, as the reading of a BPM that is stuck.
    """
    wanted, setpoints = record.readings[row], record.setpoints[row][None]

    def missing(ground: Vector) -> Vector:
        trial = copy.deepcopy(effects, {id(record.layout): record.layout})
        return wanted - _read([trial], response, setpoints, ground[None], row)[0]

    ground = wanted - response @ record.setpoints[row]
    for _ in range(_SETTLED if effects else 0):
        rest = missing(ground)
        slope = _Slope(missing, ground, rest)
        step, _ = gmres(slope, rest, rtol=1e-6, atol=_PROBE, restart=_TRIALS, maxiter=1)
        ground = ground + step
    return ground


class _Slope(LinearOperator):
    """What a small step of the ground makes of the readings, per step."""

    def __init__(self, missing: Callable[[Vector], Vector], ground: Vector, rest: Vector) -> None:
        super().__init__(np.float64, (len(rest), len(rest)))
        self._missing, self._ground, self._rest = missing, ground, rest

    def _matvec(self, x: Vector) -> Vector:
        step = _PROBE / float(np.max(np.abs(x)))
        return (self._rest - self._missing(self._ground + step * x)) / step


def _read(
    effects: Sequence[Sequence[Effect]],
    response: Matrix,
    setpoints: Matrix,
    ground: Matrix,
    tick: int,
) -> Matrix:
    """Readings of every run without their noise, shape (runs, n) [m]."""
    currents = setpoints.copy()
    for run, own in enumerate(effects):
        for effect in own:
            currents[run] = effect.actuate(currents[run], tick)
    orbit = currents @ response.T
    for run, own in enumerate(effects):
        for effect in own:
            orbit[run] = effect.respond(orbit[run], currents[run], tick)
    orbit += ground
    for run, own in enumerate(effects):
        for effect in own:
            orbit[run] = effect.disturb(orbit[run], tick)
        for effect in own:
            orbit[run] = effect.sense(orbit[run], tick)
    return orbit

"""What a planned excitation would show: the record it would give, and how far two causes differ.

The record is made from the last rows of the one at hand: its setpoints, with the excursion and
what the feedback makes of it. The feedback's gain is read off the record, mode by mode of the
response. Two causes are as far apart as the best values of the second leave them:

    D = min_θ ½ |F (δ_A − δ_B(θ))|² / S

which is the expected log-likelihood ratio if A is true (T-optimal discrimination: A. C. Atkinson
and V. V. Fedorov, Biometrika 62 (1975) 57).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.diagnose.background import GAIN_RMS
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause, added, columns_of
from orbitfb.diagnose.problem import left_out
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import Parameter
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.record import Record
from orbitfb.physics.optics import Matrix

ROWS = 400
"""Rows that are simulated for a candidate."""
_TRIES = 8
_STEPS = 4
_MOST_DEVICES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """A record that an excitation would give, but for noise.

    Args:
        record: With predicted readings.
        bench: Of the record at hand; its floor counts.
    """

    record: Record
    bench: Bench

    def white(self, cause: Cause | None) -> Matrix:
        """Change of the innovations by a cause, shape (N, n); zero for none."""
        if cause is None:
            return np.zeros_like(self.record.readings)
        return self.bench.floor.whiten(predicted(self.record, cause), self.record.starts)


def outlook(bench: Bench, excursion: Matrix, gains: Vector | None = None) -> Outlook:
    """Simulate the record that an excitation would give.

    Args:
        bench: The record at hand.
        excursion: Around the setpoints of the feedback, shape (T, m) [A]; T at most as many as
            `base_rows` gives.
        gains: Of the feedback by mode, from `loop_gains`; computed when None.
    """
    record, response = bench.record, bench.record.layout.response
    longest = max(record.stretches, key=lambda part: part.stop - part.start)
    begin = longest.stop - len(excursion)
    moved = answered(excursion, response, loop_gains(record) if gains is None else gains)
    base = record.rows(begin, longest.stop)
    orbit = bench.orbit[begin : longest.stop] + moved @ response.T
    return Outlook(replace(base, readings=orbit, setpoints=base.setpoints + moved), bench)


def base_rows(record: Record) -> int:
    """Tell how many rows a simulated excitation may have."""
    return min(ROWS, *(max(part.stop - part.start for part in record.stretches),))


def loop_gains(record: Record) -> Vector:
    """Read the feedback's gain off a record: share of each mode's orbit taken back in a tick.

    Returns:
        Shape (min(n, m),), from 0 to 1.
    """
    left, size, right = np.linalg.svd(record.layout.response, full_matrices=False)
    known = np.isfinite(record.requested).all(axis=1)
    error = record.readings if record.reference is None else record.readings - record.reference
    asked = record.requested if record.dither is None else record.requested - record.dither
    orbit, change = error[known] @ left, asked[known] @ right.T
    power = np.sum(orbit**2, axis=0)
    slope = -np.sum(orbit * change, axis=0) / np.maximum(power, 1e-300)
    return np.clip(slope * size, 0.0, 1.0)


def answered(excursion: Matrix, response: Matrix, gains: Vector) -> Matrix:
    """Add what the feedback does against an excursion to it, shape (T, m) [A]."""
    modes = np.linalg.svd(response, full_matrices=False)[2]
    wanted = excursion @ modes.T
    moved = excursion.copy()
    change = np.zeros_like(wanted)
    for mode, gain in enumerate(gains):
        # u_k = d_k + c_k and c_{k+1} = c_k − g u_k: c_{k+1} = (1 − g) c_k − g d_k
        course = lfilter([0.0, -gain], [1.0, gain - 1.0], wanted[:, mode])
        change[:, mode] = course
    return moved + change @ modes


def predicted(record: Record, cause: Cause) -> Matrix:
    """Change of the predicted readings by a cause from the first row on, shape (N, n) [m]."""
    kind, currents, orbit = cause.kind, record.setpoints, record.readings
    change = np.zeros_like(orbit)
    if isinstance(kind, ActuatorKind):
        columns = columns_of(cause, currents.shape[1])
        moved = kind.drive(currents[:, columns], cause.values, record) - currents[:, columns]
        return moved @ record.layout.response[:, columns].T
    if isinstance(kind, SensorKind):
        columns = columns_of(cause, orbit.shape[1])
        change[:, columns] = kind.distort(orbit[:, columns], cause.values, record)
        change[:, columns] -= orbit[:, columns]
    elif isinstance(kind, PairKind):
        pairs, matrices = kind.pairs(record.layout), kind.matrices(record.layout, cause.values)
        corrector = kind.target == "corrector"
        before = currents if corrector else orbit
        moved = np.zeros_like(before)
        for place in cause.places:
            tied = pairs[place]
            moved[:, tied] += before[:, tied] @ (matrices[place] - np.eye(2)).T
        change = moved @ record.layout.response.T if corrector else moved
    elif isinstance(kind, SourceKind | RingKind):
        change = added(record, replace(cause, onset=0), currents, orbit)
    return change


def separation(view: Outlook, first: Cause, second: Cause | None) -> float:
    """Give the expected log-likelihood ratio of two causes, if the first one is true [nats].

    The values of the second are those that come nearest; healthy errors of the gains of the
    devices concerned do their best too.

    Args:
        view: What the excitation would show.
        first: With its values.
        second: Its values are where the search begins; None: no effect.
    """
    if any(isinstance(c.kind, NoiseKind | LatentKind) for c in (first, second) if c is not None):
        return 0.0
    healthy = _healthy(view, [cause for cause in (first, second) if cause is not None])
    target = view.white(first)
    if second is None:
        return _distance(target, healthy)
    starts = [second, _faint(second)]
    return min(
        _distance(target - view.white(_closest(view, target, healthy, s)), healthy) for s in starts
    )


def _closest(view: Outlook, target: Matrix, healthy: Sequence[Matrix], cause: Cause) -> Cause:
    """Move the parameters to where the cause is most like the target."""
    free = [p for p in cause.kind.parameters if p.high > p.low and not left_out(p, cause)]
    for parameter in free:
        cause = _along(view, target, healthy, cause, parameter)
    if len(free) > 1:
        cause = _jointly(view, target, healthy, cause, free)
    return cause


def _faint(cause: Cause) -> Cause:
    """The same effect, hardly there: where a search begins that must not follow the first fit."""
    values = {
        p.name: cause.values[p.name] if p.log else p.nominal + 1e-3 * (p.typical - p.nominal)
        for p in cause.kind.parameters
    }
    return replace(cause, values=values)


def _moved(cause: Cause, parameter: Parameter, value: float) -> Cause:
    within = float(np.clip(value, parameter.low, parameter.high))
    return replace(cause, values={**cause.values, parameter.name: within})


def _along(
    view: Outlook, target: Matrix, healthy: Sequence[Matrix], cause: Cause, parameter: Parameter
) -> Cause:
    """Search one parameter."""
    value = cause.values[parameter.name]
    if cause.kind.linear == parameter.name and value != parameter.nominal:
        change = view.white(cause)
        share = float(np.sum(change * target)) / max(float(np.sum(change**2)), 1e-300)
        there = parameter.nominal + share * (value - parameter.nominal)
        return _moved(cause, parameter, there)
    if parameter.log:
        middle = np.log(max(value, parameter.low, 1e-9 * parameter.high))
        low, high = middle - 1.5, middle + 1.5
    else:
        reach = max(abs(value - parameter.nominal), 0.5 * abs(parameter.typical))
        low, high = (
            max(value - 1.5 * reach, parameter.low),
            min(value + 1.5 * reach, parameter.high),
        )

    def at(number: float) -> Cause:
        return _moved(cause, parameter, float(np.exp(number)) if parameter.log else number)

    def cost(number: float) -> float:
        return _distance(target - view.white(at(number)), healthy)

    found: Any = minimize_scalar(
        cost, bounds=(low, high), method="bounded", options={"maxiter": _TRIES}
    )
    before = _distance(target - view.white(cause), healthy)
    return at(float(found.x)) if float(found.fun) < before else cause


def _jointly(
    view: Outlook,
    target: Matrix,
    healthy: Sequence[Matrix],
    cause: Cause,
    free: Sequence[Parameter],
) -> Cause:
    """Search several parameters: Gauss and Newton, as long as it helps."""
    now = _distance(target - view.white(cause), healthy)
    for _ in range(_STEPS):
        white = view.white(cause)
        steps = [_step(p, cause.values[p.name]) for p in free]
        slopes = np.stack(
            [
                np.ravel(view.white(_moved(cause, p, cause.values[p.name] + size)) - white) / size
                for p, size in zip(free, steps, strict=True)
            ],
            axis=1,
        )
        scale = np.sqrt(np.sum(slopes**2, axis=0)) + 1e-300
        move = np.linalg.lstsq(slopes / scale, np.ravel(target - white), rcond=1e-9)[0] / scale
        for share in (1.0, 0.3, 0.1):
            there = cause
            for parameter, length in zip(free, move, strict=True):
                value = cause.values[parameter.name] + share * float(length)
                there = _moved(there, parameter, value)
            cost = _distance(target - view.white(there), healthy)
            if cost < now - 1e-3:
                cause, now = there, cost
                break
        else:
            break
    return cause


def _step(parameter: Parameter, value: float) -> float:
    usual = abs(parameter.typical) or parameter.high - parameter.low
    size = 0.01 * max(abs(value - parameter.nominal), 0.01 * usual)
    return -size if value + size > parameter.high else size


def _healthy(view: Outlook, causes: Sequence[Cause]) -> list[Matrix]:
    """Innovations of one standard deviation of the gains of the devices concerned."""
    record, bench = view.record, view.bench
    found: list[Matrix] = []
    for cause in causes:
        if bench.scale == 0.0 or cause.kind.target not in ("bpm", "corrector"):
            continue
        if isinstance(cause.kind, PairKind) or not cause.places:
            continue
        for place in cause.places[:_MOST_DEVICES]:
            if cause.kind.target == "corrector":
                change = np.outer(record.setpoints[:, place], record.layout.response[:, place])
            else:
                change = np.zeros_like(record.readings)
                change[:, place] = record.readings[:, place]
            found.append(bench.floor.whiten(GAIN_RMS * bench.scale * change, record.starts))
    return found


def _distance(change: Matrix, healthy: Sequence[Matrix]) -> float:
    """½ |change|², less what healthy errors of unit prior scatter explain of it."""
    whole = float(np.sum(change**2))
    if healthy:
        score = np.array([float(np.sum(change * each)) for each in healthy])
        matrix = np.array([[float(np.sum(a * b)) for b in healthy] for a in healthy])
        whole -= float(score @ np.linalg.solve(matrix + np.eye(len(healthy)), score))
    return 0.5 * max(whole, 0.0)

"""How far a planned excitation drives two causes apart.

Two causes are as far apart as the best values of the second leave them:

    D = min_θ ½ |F (δ_A − δ_B(θ))|² / S

which is the expected log-likelihood ratio if A is true (T-optimal discrimination: A. C. Atkinson
and V. V. Fedorov, Biometrika 62 (1975) 57).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfb.diagnose.background import GAIN_RMS
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.free import beyond
from orbitfb.diagnose.plan_outlook import Outlook
from orbitfb.diagnose.problem import left_out
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Parameter
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.physics.optics import Matrix

_TRIES = 8
_SOLVED = 0.1
"""Gain of a step of the healthy errors below which they are the best [nats]."""
_MOST_STEPS = 60
"""Of the search for the healthy errors: an excitation shows a change far better than a record."""
_STEPS = 4
_MOST_DEVICES = 6


def separation(view: Outlook, first: Cause, second: Cause | None) -> float:
    """Give the expected log-likelihood ratio of two causes, if the first one is true [nats].

    The values of the second are those that come nearest; healthy errors do their best too.

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
        return _beyond_healthy(view, target, healthy)
    starts = [second, _faint(second)]
    changes = (target - view.white(_closest(view, target, healthy, s)) for s in starts)
    return min(_beyond_healthy(view, change, healthy) for change in changes)


def _beyond_healthy(view: Outlook, change: Matrix, healthy: Sequence[Matrix]) -> float:
    """Distance, beside all healthy errors if the outlook has them."""
    near = _distance(change, healthy)
    if view.errors is None:
        return near
    left = view.errors.against(change, _SOLVED, beyond(), _MOST_STEPS)[0]
    return min(0.5 * float(np.vdot(change, left)), near)


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

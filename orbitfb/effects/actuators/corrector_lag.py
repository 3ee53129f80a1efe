"""A corrector whose kick follows its setpoint with a time constant."""

import math

import numpy as np
from scipy.linalg import expm

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, filtered, ladder
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_NONE = 1e-6  # [s]; a second time constant that no record tells from none
_SHORT = (0.145, 0.17)
"""Shortest time constants of the grid, in periods: what they leave is not proportional to them."""


class CorrectorLag(ActuatorKind):
    """Kicks behind a low-pass: eddy currents, or the regulator of the supply, or both in a row."""

    id = "corrector-lag"
    stage = "actuator"
    title = "lag of a corrector"
    sentence = (
        "The kick approaches its setpoint exponentially. When the next orbit is read, a part of it "
        "is still missing. The reason is an eddy current in the chamber or a slow power supply. "
        "The feedback overshoots unless its gain is lowered or the lag is in its model."
    )
    equation = (
        "τ dθ/dt = c − θ behind τ₂ dc/dt = u − c, exact for setpoints held over the period T; with "
        "one time constant θ_n = α θ_{n−1} + (1 − α) u_n, α = exp(−T/τ)"
    )
    parameters = (
        Parameter(
            name="tau",
            unit="s",
            low=0.0,
            high=100.0,
            nominal=0.0,
            typical=0.1,
            description="Time constant τ.",
            log=True,
        ),
        Parameter(
            name="second",
            unit="s",
            low=_NONE,
            high=100.0,
            nominal=_NONE,
            typical=_NONE,
            description=(
                "Second time constant τ₂, for example of a chamber in addition to that of the "
                "supply."
            ),
            log=True,
            optional=True,
        ),
    )
    confused_with = (
        "loop-delay",
        "bpm-lowpass",
        "bpm-latency",
        "corrector-slew",
        "corrector-gain",
        "corrector-resonance",
    )
    splits = (
        "Steps or tones at three frequencies. Unlike a delay, a lag has a tail. Unlike a slew "
        "rate, it does not depend on the amplitude. It leaves the noise of the BPMs white."
    )

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Filter."""
        period, tau, second = record.layout.period, values["tau"], _second(values)
        alpha, beta = _alpha(tau, period), _alpha(second, period)
        if second <= _NONE:
            if alpha == 0.0:
                return setpoints.copy()
            return filtered(setpoints, np.array([1.0 - alpha]), np.array([1.0, -alpha]), record)
        answer = _answer(tau, second, period)
        denominator = np.array([1.0, -alpha - beta, alpha * beta])
        numerator = np.array([answer, float(np.sum(denominator)) - answer])
        return filtered(setpoints, numerator, denominator, record)

    def grid(self, record: Record) -> tuple[Values, ...]:
        """17 time constants from those that leave 0.1 % after a period to 50 periods."""
        steps = (*_SHORT, *np.geomspace(0.2, 50.0, 15))
        return ladder("tau", {"second": _NONE}, record.layout.period * np.array(steps))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Filter tick by tick."""
        return _Lag(places, values, layout.period)


class _Lag(ColumnsEffect):
    """State: what the first low-pass gives, and what the second makes of it."""

    def __init__(self, places: Indices, values: Values, period: float) -> None:
        super().__init__(places)
        tau, second = values["tau"], _second(values)
        if second > _NONE:
            first, last = 1.0 / max(tau, _NONE), 1.0 / second
            self._step = np.asarray(expm(np.array([[-first, first], [0.0, -last]]) * period))
        else:
            self._step = np.diag([_alpha(tau, period), 0.0])
        self._state: Matrix | None = None

    def follow(self, wanted: Vector) -> Vector:
        there = np.stack([wanted, wanted])
        before = there if self._state is None else self._state
        self._state = there + self._step @ (before - there)
        return self._state[0]


def _second(values: Values) -> float:
    """Second time constant [s]; none where it is left out."""
    return values.get("second", _NONE)


def _alpha(tau: float, period: float) -> float:
    """Share of a difference that is left after one period."""
    return math.exp(-period / tau) if tau > 0 else 0.0


def _answer(tau: float, second: float, period: float) -> float:
    """What both low-passes let through of a step after one period.

    1 − (τ exp(−T/τ) − τ₂ exp(−T/τ₂)) / (τ − τ₂), and its limit 1 − (1 + T/τ) exp(−T/τ) for equal
    ones.
    """
    if abs(tau - second) < 1e-4 * (tau + second):
        share = 2.0 * period / (tau + second)
        return 1.0 - (1.0 + share) * math.exp(-share)
    left = tau * _alpha(tau, period) - second * _alpha(second, period)
    return 1.0 - left / (tau - second)

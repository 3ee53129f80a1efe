"""A corrector that rings: a second-order regulator, support or chamber."""

import cmath
import math

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, filtered
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_STIFF = 1e5  # [Hz]; from here on nothing is left of it
_OVERSHOOTS = ((0.6, 0.3), (0.7, 0.5), (0.8, 0.6), (0.83, 0.8), (0.95, 0.85), (0.8, 0.85))
"""Frequencies in units of the rate, and dampings, that overshoot in one tick by 33, 13, 6, 1.5, 0.6
and 0.2 %."""
_SETTLED = ((0.5, 1.0), (0.6, 1.0), (0.8, 1.0), (1.0, 1.0), (0.75, 0.85), (0.77, 0.85))
"""The same for what has nearly settled after a tick, 18, 11, 4, 1, 0.4 and 0.1 % short: as a lag
does."""

_OVERSHOT = 0.01
"""Share of a step by which the rows overshoot it at least [1]: what overshoots less cannot be told
from a lag. By hand."""


class CorrectorResonance(ActuatorKind):
    """Kicks behind a second-order system, exact for setpoints held over the period."""

    id = "corrector-resonance"
    stage = "actuator"
    title = "resonance of a corrector"
    sentence = (
        "The kick overshoots a step and rings before it settles. The regulator of the power supply "
        "is badly tuned, or something has a resonance. Tune the regulator, or keep the feedback "
        "below this frequency."
    )
    equation = "d²θ/dt² + 2 ζ ω₀ dθ/dt + ω₀² θ = ω₀² u with ω₀ = 2π f"
    parameters = (
        Parameter(
            name="frequency",
            unit="Hz",
            low=1e-3,
            high=_STIFF,
            nominal=_STIFF,
            typical=2.0,
            description="Frequency f of the undamped resonance.",
            log=True,
        ),
        Parameter(
            name="damping",
            unit="1",
            low=1e-3,
            high=1.0,
            nominal=0.3,
            typical=0.3,
            description="Damping ratio ζ. Above 1 it would be a lag with two time constants.",
            log=True,
        ),
    )
    confused_with = ("corrector-lag", "loop-delay", "periodic-disturbance")
    splits = "Tones around the suspected frequency. Only a resonance amplifies them."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Filter."""
        if values["frequency"] >= _STIFF:
            return setpoints.copy()
        numerator, denominator = _filter(
            values["frequency"], values["damping"], record.layout.period
        )
        return filtered(setpoints, numerator, denominator, record)

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """What does not overshoot is a lag."""
        if values["frequency"] >= _STIFF:
            return ""
        numerator, denominator = _filter(
            values["frequency"], values["damping"], record.layout.period
        )
        step = np.asarray(lfilter(numerator, denominator, np.ones(len(setpoints))))
        return "" if step.max() > 1.0 + _OVERSHOT else "nothing overshoots"

    def grid(self, record: Record) -> tuple[Values, ...]:
        """10 frequencies from a hundredth to nearly half the rate, with 2 dampings; 12 beyond."""
        rate = 1.0 / record.layout.period
        rings = [(float(f), d) for f in np.geomspace(0.01, 0.45, 10) for d in (0.1, 0.5)]
        return tuple(
            {"frequency": rate * frequency, "damping": damping}
            for frequency, damping in (*rings, *_OVERSHOOTS, *_SETTLED)
        )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Move a state on, tick by tick."""
        if values["frequency"] >= _STIFF:
            return Effect()
        return _Resonance(places, values["frequency"], values["damping"], layout.period)


class _Resonance(ColumnsEffect):
    """State: current and its rate in units of ω₀ A."""

    def __init__(self, places: Indices, frequency: float, damping: float, period: float) -> None:
        super().__init__(places)
        turn = 2 * np.pi * frequency * period
        self._step = np.asarray(expm(turn * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])))
        self._state: Matrix | None = None

    def follow(self, wanted: Vector) -> Vector:
        rest = np.stack([wanted, np.zeros_like(wanted)])
        before = rest if self._state is None else self._state
        self._state = rest + self._step @ (before - rest)
        return self._state[0]


def _filter(frequency: float, damping: float, period: float) -> tuple[Vector, Vector]:
    """Coefficients of the filter that has the step response of the system at every row.

    With the poles s₁, s₂ of the system, its step response
    y(t) = 1 − (s₂ exp(s₁ t) − s₁ exp(s₂ t)) / (s₂ − s₁): the first answer is y(T), and the sum
    of the numerator is that of the denominator because the gain is 1.
    """
    omega = 2 * math.pi * frequency
    mean, half = complex(-omega * damping), omega * cmath.sqrt(damping**2 - 1.0)
    left, right = cmath.exp((mean + half) * period), cmath.exp((mean - half) * period)
    if abs(half * period) < 0.5:  # the same without a difference of nearly equal terms
        angle = half * period
        share = period * (cmath.sinh(angle) / angle if abs(angle) > 1e-8 else 1.0)
        still_to_go = cmath.exp(mean * period) * (cmath.cosh(angle) - mean * share)
    else:
        still_to_go = 0.5 * ((left + right) - mean * (left - right) / half)
    answer = 1.0 - still_to_go.real
    denominator = np.array([1.0, -(left + right).real, (left * right).real])
    return np.array([answer, float(np.sum(denominator)) - answer]), denominator

"""A corrector whose kick follows its setpoint with a time constant."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, filtered, ladder
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


class CorrectorLag(ActuatorKind):
    """Kicks behind a first-order low-pass: eddy currents, or the regulator of the supply."""

    id = "corrector-lag"
    stage = "actuator"
    title = "first-order lag of a corrector"
    sentence = (
        "The kick approaches its setpoint exponentially and is not there in full when the next "
        "orbit is read: eddy currents in the chamber, or a slow power supply. The feedback "
        "overshoots unless its gain is lowered or the lag is in its model."
    )
    equation = (
        "θ_n = α θ_{n−1} + (1 − α) u_n with α = exp(−T/τ): τ dθ/dt = u − θ, exact for setpoints "
        "held over the period T"
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
        "Steps or tones at three frequencies: a lag has a tail that a delay lacks, does not "
        "depend on the amplitude as a slew rate does, and leaves the noise of the BPMs white."
    )

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Filter."""
        alpha = _alpha(values["tau"], record.layout.period)
        if alpha == 0.0:
            return setpoints.copy()
        return filtered(setpoints, np.array([1.0 - alpha]), np.array([1.0, -alpha]), record)

    def grid(self, record: Record) -> tuple[Values, ...]:
        """15 time constants from a fifth of the period (0.7 % left after it) to 50 periods."""
        return ladder("tau", {}, record.layout.period * np.geomspace(0.2, 50.0, 15))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Filter tick by tick."""
        return _Lag(places, _alpha(values["tau"], layout.period))


class _Lag(ColumnsEffect):
    def __init__(self, places: Indices, alpha: float) -> None:
        super().__init__(places)
        self._alpha = alpha
        self._current: Vector | None = None

    def follow(self, wanted: Vector) -> Vector:
        before = wanted if self._current is None else self._current
        self._current = wanted + self._alpha * (before - wanted)
        return self._current


def _alpha(tau: float, period: float) -> float:
    """Share of a difference that is left after one period."""
    return math.exp(-period / tau) if tau > 0 else 0.0

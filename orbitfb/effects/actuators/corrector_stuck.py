"""A corrector that no longer follows its setpoint."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, ladder
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_AT_ONCE = 1e-9  # [s]
_ALL = 1.0
"""Of the current."""
_MOST = 0.9
_FROZEN = 0.999


class CorrectorStuck(ActuatorKind):
    """A current that stays what it was, or falls to a share of it, from the onset on.

    How much is left is an optional parameter, as a frozen current is all of it; so is the time over
    which a magnet's inductance lets it fall.

    `drive` holds the first row that it is given: for an onset it wants the record that begins
    there (`Record.rows`). Later stretches hold the same current: a gap in time frees nothing.
    """

    id = "corrector-stuck"
    stage = "actuator"
    title = "corrector that is stuck or tripped"
    sentence = (
        "The current of the corrector no longer follows its setpoint. The power supply hangs (the "
        "current stays) or has tripped (the current is zero). Compare readback and setpoint, reset "
        "the supply, or take the corrector out of the correction."
    )
    equation = (
        "θ_n = u_onset (s + (1 − s) exp(−t/τ)), t the time since the tick before the onset; "
        "s = 1: frozen, s = 0: tripped"
    )
    parameters = (
        Parameter(
            name="left",
            unit="1",
            low=0.0,
            high=1.0,
            nominal=1.0,
            typical=1.0,
            description=(
                "Share s of the current at the onset that remains: 1 is frozen, 0 is tripped."
            ),
            optional=True,
        ),
        Parameter(
            name="decay",
            unit="s",
            low=_AT_ONCE,
            high=1e3,
            nominal=_AT_ONCE,
            typical=_AT_ONCE,
            description="Time constant τ with which the current falls.",
            log=True,
            optional=True,
        ),
    )
    confused_with = ("corrector-gain", "corrector-saturation", "corrector-deadband", "local-kick")
    splits = "The readback of its current, or a step of this corrector alone. Nothing moves."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Hold the first row, or let it fall."""
        since = np.arange(1, len(setpoints) + 1) * record.layout.period
        fallen = np.exp(-since / values.get("decay", _AT_ONCE))
        left = values.get("left", _ALL)
        share = left + (1.0 - left) * fallen
        return share[:, None] * setpoints[:1]

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Frozen, and tripped."""
        return ladder("left", {"decay": _AT_ONCE}, (1.0, 0.0))

    def long_after(self, values: Values) -> Values:
        """What falls has fallen."""
        return {**values, "decay": _AT_ONCE}

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold what is wanted at the first tick, or lose it by the tick."""
        kept = math.exp(-layout.period / values.get("decay", _AT_ONCE))
        return _Stuck(places, values.get("left", _ALL), kept)


class _Stuck(ColumnsEffect):
    def __init__(self, places: Indices, left: float, kept: float) -> None:
        super().__init__(places)
        self._left, self._kept = left, kept
        self._lost: Vector | None = None
        self._held = np.zeros(0)

    def follow(self, wanted: Vector) -> Vector:
        if self._lost is None:
            self._held = self._left * wanted
            self._lost = wanted - self._held
        self._lost = self._kept * self._lost
        return self._held + self._lost

"""A corrector that no longer follows its setpoint."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices


class CorrectorStuck(ActuatorKind):
    """A current that stays what it was, or falls to a share of it, from the onset on.

    `drive` holds the first row that it is given: for an onset it wants the record that begins
    there (`Record.rows`). Later stretches hold the same current: a gap in time frees nothing.
    """

    id = "corrector-stuck"
    stage = "actuator"
    title = "corrector that is stuck or tripped"
    sentence = (
        "The current of the corrector no longer follows its setpoint: the power supply hangs "
        "(the whole current is left) or has tripped (nothing is left). Compare its readback "
        "with its setpoint, reset it, or take it out of the correction."
    )
    equation = "θ_n = s · u_onset for n ≥ onset; s = 1: frozen, s = 0: tripped"
    parameters = (
        Parameter(
            name="left",
            unit="1",
            low=0.0,
            high=1.0,
            nominal=1.0,
            typical=1.0,
            description="Share s of the current at the onset that is left: 1 frozen, 0 tripped.",
        ),
    )
    vanishes = False
    confused_with = ("corrector-gain", "corrector-saturation", "corrector-deadband", "local-kick")
    splits = "The readback of its current, or a step of this corrector alone: nothing moves."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Hold the first row."""
        return np.broadcast_to(values["left"] * setpoints[:1], setpoints.shape).copy()

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Frozen, and tripped."""
        return ({"left": 1.0}, {"left": 0.0})

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold what is wanted at the first tick."""
        return _Stuck(places, values["left"])


class _Stuck(ColumnsEffect):
    def __init__(self, places: Indices, left: float) -> None:
        super().__init__(places)
        self._left = left
        self._held: Vector | None = None

    def follow(self, wanted: Vector) -> Vector:
        if self._held is None:
            self._held = self._left * wanted
        return self._held

"""A corrector whose kick per ampere is not the calibrated one."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, lacks_motion
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import CALIBRATION_ERROR, Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorGain(ActuatorKind):
    """Currents that are a constant factor off."""

    id = "corrector-gain"
    stage = "actuator"
    title = "gain error of a corrector"
    sentence = (
        "The corrector kicks the beam by a constant factor more or less than its calibration says. "
        "Check its calibration and its power supply, and whether a coil is shorted."
    )
    equation = "θ_n = (1 + g) u_n (the corrector gain of J. Safranek, NIM A 388 (1997) 27)"
    parameters = (
        Parameter(
            name="gain",
            unit="1",
            low=-0.95,
            high=3.0,
            nominal=0.0,
            typical=0.1,
            description="Relative error g of the kick per ampere.",
        ),
    )
    linear = "gain"
    delays = 3
    confused_with = (
        "bpm-gain",
        "corrector-lag",
        "corrector-slew",
        "corrector-stuck",
        "corrector-polarity",
        "quadrupole-gradient",
    )
    splits = (
        "Steps of this corrector alone in several sizes, watched for some ticks. A common gain of "
        "all correctors can be told from that of all BPMs only by an RF step or one calibrated "
        "corrector."
    )

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Scale."""
        return setpoints * (1.0 + values["gain"])

    def healthy_scatter(self, layout: Layout) -> Vector:
        """One per cent each."""
        return np.full(len(layout.correctors), CALIBRATION_ERROR)

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """A current of which nothing is left is off."""
        return lacks_motion(setpoints, self.drive(setpoints, values, record))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Scale tick by tick."""
        return _Gain(places, values["gain"])


class _Gain(ColumnsEffect):
    def __init__(self, places: Indices, gain: float) -> None:
        super().__init__(places)
        self._gain = gain

    def follow(self, wanted: Vector) -> Vector:
        return wanted + self._gain * wanted

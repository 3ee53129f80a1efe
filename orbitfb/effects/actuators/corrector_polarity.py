"""A corrector that kicks the wrong way."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorPolarity(ActuatorKind):
    """Currents of the wrong sign."""

    id = "corrector-polarity"
    stage = "actuator"
    title = "wrong polarity of a corrector"
    sentence = (
        "The corrector kicks the beam the wrong way, by the right amount. Its leads are exchanged, "
        "or its sign in the configuration is wrong. The feedback may run away."
    )
    equation = "θ_n = −u_n"
    parameters = ()
    confused_with = ("corrector-gain", "corrector-swap", "bpm-polarity")
    splits = "A step of this corrector alone. The orbit moves opposite to the model."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Turn the sign round."""
        return -setpoints

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Turn the sign round tick by tick."""
        return _Polarity(places)


class _Polarity(ColumnsEffect):
    def follow(self, wanted: Vector) -> Vector:
        return -wanted

"""Two correctors whose setpoints are exchanged."""

import numpy as np

from orbitfb.effects.actuating import PairsEffect, couples, pairs_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorSwap(PairKind):
    """Currents of two correctors, or of the two planes of one, exchanged."""

    id = "corrector-swap"
    stage = "actuator"
    target = "corrector"
    title = "exchanged correctors"
    sentence = (
        "Each of two correctors gets the setpoint of the other. Their cables, or their names in "
        "the configuration, are exchanged. The feedback may run away."
    )
    equation = "θ_j = u_k, θ_k = u_j"
    parameters = ()
    collective = False
    confused_with = ("corrector-gain", "corrector-polarity", "bpm-swap")
    splits = (
        "A step of one of the two alone. The orbit moves as the model predicts for the other one."
    )

    def unavailable(self, record: Record) -> str:
        """Need a pair."""
        return "" if len(self.pairs(record.layout)) else "needs two correctors"

    def pairs(self, layout: Layout) -> Indices:
        """Any two correctors of a plane, and the two planes of one corrector."""
        ordered = pairs_of(layout, cells=False)
        return ordered[ordered[:, 0] < ordered[:, 1]]

    def matrix(self, values: Values) -> Matrix:
        """Exchange."""
        return np.array([[0.0, 1.0], [1.0, 0.0]])

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Exchange the places two by two, in their order.

        Raises:
            ConfigError: The places are not an even number.
        """
        pairs = couples(places, self.id)
        change = np.array([[-1.0, 1.0], [1.0, -1.0]])
        return PairsEffect(pairs, np.broadcast_to(change, (len(pairs), 2, 2)))

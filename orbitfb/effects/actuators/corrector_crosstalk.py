"""A corrector that feels the current of another."""

import numpy as np

from orbitfb.effects.actuating import PairsEffect, couples, pairs_of
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorCrosstalk(PairKind):
    """A share of the current of the first corrector appears in the second."""

    id = "corrector-crosstalk"
    stage = "actuator"
    target = "corrector"
    title = "crosstalk between correctors"
    sentence = (
        "A share of the current of one corrector also appears in another. Their power supplies "
        "share a rail or a ground, or their coils are neighbours. Check what the two have in "
        "common."
    )
    equation = "θ_k = u_k + c u_j (from the first, j, to the second, k)"
    parameters = (
        Parameter(
            name="share",
            unit="1",
            low=-3.0,
            high=3.0,
            nominal=0.0,
            typical=0.1,
            description=(
                "Share c of the current of the first corrector that appears in the second."
            ),
        ),
    )
    linear = "share"
    collective = False
    confused_with = ("corrector-gain", "corrector-swap", "corrector-roll", "quadrupole-gradient")
    splits = (
        "Steps of the first corrector while the second stands still. Then only the first should "
        "kick."
    )

    def unavailable(self, record: Record) -> str:
        """Need a pair."""
        return "" if len(self.pairs(record.layout)) else "needs two correctors"

    def pairs(self, layout: Layout) -> Indices:
        """(from, to): any two of a plane, and of a cell; but not the coils of one corrector.

        That a share of the one appears in the other is a roll of it.
        """
        pairs, names = pairs_of(layout, cells=True), np.array(layout.correctors.names)
        return pairs[names[pairs[:, 0]] != names[pairs[:, 1]]]

    def matrix(self, values: Values) -> Matrix:
        """Add the first to the second."""
        return np.array([[1.0, 0.0], [values["share"], 1.0]])

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let the places talk two by two, in their order: from the first to the second.

        Raises:
            ConfigError: The places are not an even number.
        """
        pairs = couples(places, self.id)
        change = np.array([[0.0, 0.0], [values["share"], 0.0]])
        return PairsEffect(pairs, np.broadcast_to(change, (len(pairs), 2, 2)))

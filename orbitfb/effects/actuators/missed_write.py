"""Ticks in which no setpoint arrives."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import changes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class MissedWrite(LatentKind):
    """The setpoints of a tick are lost, of all correctors or of those of a crate.

    The next ones, absolute, make good for it.

    The plant keeps the last set that arrived. `shapes` tells what one lost set does; what is lost
    in a row adds up.
    """

    id = "missed-write"
    stage = "timing"
    target = "corrector"
    strength = "always one"
    title = "missed writes of setpoints"
    sentence = (
        "At some ticks the setpoints do not arrive in time, and the correctors stay where they "
        "were until the next ones come. Check for lost packets, full queues and a busy computer: "
        "that of the loop if all correctors are affected, else that of the crate."
    )
    equation = "θ_n = θ_{n−1} with probability p, else u_n, of all correctors of a crate at once"
    parameters = (
        Parameter(
            name="probability",
            unit="1",
            low=0.0,
            high=0.9,
            nominal=0.0,
            typical=0.02,
            description="Probability p that the setpoints of a tick do not arrive.",
            log=True,
        ),
    )
    confused_with = ("loop-delay", "clock-jitter", "missed-read", "corrector-deadband")
    splits = "Sequence numbers or time stamps of the writes, or the readbacks of the currents."

    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Take the change of the currents back, shape (N, n) [m]."""
        return self.moves(record, currents) @ record.layout.response.T

    def moves(self, record: Record, currents: Matrix) -> Matrix:
        """Take them back, corrector by corrector, shape (N, m) [A]."""
        return -changes(currents, record)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Lose sets of setpoints; the first one arrives."""
        return _Missed(places, values["probability"], rng)


class _Missed(Effect):
    def __init__(self, places: Indices, probability: float, rng: np.random.Generator) -> None:
        self._places = places if len(places) else slice(None)
        self._probability, self._rng = probability, rng
        self._arrived: Vector | None = None

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Keep the last set that arrived, now and then."""
        lost = self._rng.random() < self._probability
        acting = setpoints.copy()
        if self._arrived is not None and lost:
            acting[self._places] = self._arrived[self._places]
        self._arrived = acting
        return acting.copy()

"""Ticks at which the orbit of the tick before is read again."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class MissedRead(LatentKind):
    """With the probability p the reading of the tick before is read once more, all BPMs."""

    id = "missed-read"
    stage = "timing"
    strength = "always one"
    parameters = (
        Parameter(
            "probability",
            "1",
            0.0,
            0.5,
            0.0,
            0.01,
            "Probability that a tick has no new orbit.",
            log=True,
        ),
    )
    title = "orbits that are read twice"
    sentence = (
        "At some ticks no new orbit came, and the last one was used again, equal to the last "
        "digit. Check the network between BPMs and feedback, and the load of its computers."
    )
    equation = "y_n = y_(n−1), noise included, with probability p, else x_n + v_n"
    confused_with = ("bpm-stuck", "bpm-latency", "clock-jitter", "missed-write")
    splits = "Sequence numbers or time stamps, or orbits that repeat exactly."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Repeat readings; it must come after all effects that change readings."""
        return _Repeats(values["probability"], rng)

    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Orbit of the row before less that of the row; zero at the beginning of a stretch."""
        change = np.zeros_like(orbit)
        change[1:] = orbit[:-1] - orbit[1:]
        change[record.starts] = 0.0
        return change


class _Repeats(Effect):
    """Readings that are given again now and then.

    Args:
        probability: Per tick.
        rng: Random numbers.
    """

    def __init__(self, probability: float, rng: np.random.Generator) -> None:
        self._probability, self._rng = probability, rng
        self._last: Vector | None = None

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Give the last readings again, or the new ones."""
        missed = self._rng.random() < self._probability
        if self._last is None or not missed:
            self._last = orbit.copy()
        return self._last.copy()

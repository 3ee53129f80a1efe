"""Orbits that are sampled early or late."""

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


class ClockJitter(LatentKind):
    """y_n = x(t_n + δ_n), δ normal and new at every tick, one for all BPMs or for those of a crate.

    Crates have triggers of their own. If the orbit stands still after it moved, only an early
    sample is wrong, and δ has a mean.
    """

    id = "clock-jitter"
    stage = "timing"
    target = "bpm"
    strength = "normal"
    parameters = (
        Parameter(
            "rms", "s", 0.0, 10.0, 0.0, 0.01, "Rms error of the sampling time, its mean included.",
            log=True,
        ),
        Parameter(
            "mean", "s", -10.0, 10.0, 0.0, 0.0,
            "Mean error, negative where samples are early; the rest of the rms is random.",
            optional=True,
        ),
    )  # fmt: skip
    title = "jitter of the time of sampling"
    sentence = (
        "The BPMs sample the orbit a little early or late, by another amount at every tick. While "
        "the orbit moves, the readings have an error in the shape of that motion. Check the "
        "trigger of the BPMs: the common one if all BPMs are affected, else that of the crate."
    )
    equation = (
        "y_n = x_n + δ_n (x_n − x_(n−1)) / T, δ_n normal and the same for all BPMs of a crate: the "
        "slope of the orbit, not that of the noise"
    )
    confused_with = ("missed-read", "missed-write", "loop-delay", "noise-correlated")
    splits = "The BPMs' own time stamps, or steps of the orbit, which make the error large."

    def grid(self, record: Record) -> tuple[Values, ...]:
        """From a thousandth of a tick to three ticks."""
        period, high = record.layout.period, self.parameters[0].high
        shares = np.geomspace(1e-3, 3.0, 8)
        return tuple({"rms": min(float(one) * period, high), "mean": 0.0} for one in shares)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Shift the samples; it must come after all effects that disturb the orbit."""
        struck = np.zeros(len(layout.bpms))
        struck[places if len(places) else slice(None)] = 1.0
        mean = values.get("mean", 0.0)
        spread = np.sqrt(max(values["rms"] ** 2 - mean**2, 0.0))
        return _Jitter(spread / layout.period, mean / layout.period, struck, rng)

    def shapes(self, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Slope of the orbit that the correctors make [m/s]; zero at the beginning of a stretch.

        That of the predicted orbit has the noise of earlier readings in it, which makes it too
        steep and the jitter 12 % too small.
        """
        return changes(currents, record) @ record.layout.response.T / record.layout.period


class _Jitter(Effect):
    """Readings shifted along the motion of the true orbit.

    Args:
        spread: Standard deviation of the shift [periods].
        mean: Of the shift [periods].
        struck: 1 at BPMs that it shifts, else 0, shape (n,).
        rng: Random numbers.
    """

    def __init__(
        self, spread: float, mean: float, struck: Vector, rng: np.random.Generator
    ) -> None:
        self._spread, self._mean, self._struck, self._rng = spread, mean, struck, rng
        self._last: Vector | None = None
        self._step: Vector = np.zeros(0)

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Keep how far the orbit moved since the last tick."""
        self._step = np.zeros_like(orbit) if self._last is None else orbit - self._last
        self._last = orbit.copy()
        return orbit

    def sense(self, orbit: Vector, tick: int) -> Vector:
        """Shift the sample."""
        shift = self._mean + self._spread * self._rng.standard_normal()
        return orbit + shift * self._struck * self._step

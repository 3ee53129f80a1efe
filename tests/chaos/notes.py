"""What a soft IOC notes of the puts that it gets, whoever sends them."""

import time

import numpy as np

from tests.chaos.journal import Journal

FORGIVEN = 5
"""Ticks for which a put may still assume the setpoint before somebody's hand."""

WINDOW = 5
"""Orbits over which puts are counted against orbits that may be acted on."""


class Notes:
    """Sees every put, and writes down what came between two ticks.

    Args:
        journal: Where.
        life: Which start of the IOC this is.
        limit: Largest |setpoint| that the loop may put [A].
        step: Longest step of one put [A].
        size: Of the setpoints.
    """

    def __init__(self, journal: Journal, life: int, limit: float, step: float, size: int) -> None:
        self._journal, self._life, self._limit, self._step = journal, life, limit, step
        self._window = np.zeros((WINDOW, size), dtype=int)  # puts by orbit, the newest last
        self._goods = np.ones(WINDOW, dtype=bool)
        self._moved = np.full(size, -FORGIVEN)
        self._good = self._tick = 0
        self._faults = 0
        self._shape = (0.0, 0.0)
        self._clear()

    def _clear(self) -> None:
        self._sums = {"puts": 0, "nonfinite": 0, "beyond": 0, "steps": 0, "refused": 0}
        self._excess, self._largest, self._longest = 0, 0.0, 0.0

    def moved(self, index: int) -> None:
        """Forgive the next puts to a setpoint that a hand has moved."""
        self._moved[index] = self._tick

    def put(self, which: np.ndarray, values: np.ndarray, before: np.ndarray, drive: float) -> None:
        """Note puts as they came.

        Args:
            which: Setpoints.
            values: Asked for [A].
            before: In force [A].
            drive: Limit of this IOC [A].
        """
        finite = np.isfinite(values)
        size = np.abs(values[finite])
        step = np.abs(values - before)[finite]
        strange = self._tick - self._moved[which[finite]] >= FORGIVEN
        self._sums["puts"] += len(values)
        self._sums["nonfinite"] += int((~finite).sum())
        # What somebody's hand has left beyond the limit may be put back towards it.
        same_side = np.sign(values[finite]) == np.sign(before[finite])
        most = np.maximum(self._limit, np.abs(before[finite]) * same_side)
        self._sums["beyond"] += int((size > most + 1e-9).sum())
        self._sums["steps"] += int((strange & (step > self._step + 1e-9)).sum())
        self._sums["refused"] += int((size > drive + 1e-9).sum())
        self._largest = max(self._largest, float(size.max(initial=0.0)))
        self._longest = max(self._longest, float(step[strange].max(initial=0.0)))
        np.add.at(self._window[-1], which, 1)
        if not self._goods[-1]:
            excess = self._window.sum(axis=0)[which] - self._goods.sum()
            self._excess = max(self._excess, int(excess.max(initial=0)))

    def tick(self, tick: int, good: bool, orbit: np.ndarray, faults: int) -> None:
        """Write down what came since the last orbit; begin the next one."""
        self._journal.write(
            wall=time.time(),
            tick=self._tick,
            life=self._life,
            good=self._good,
            excess=self._excess,
            largest=self._largest,
            step=self._longest,
            rms=self._shape[0],
            peak=self._shape[1],
            faults=self._faults,
            **self._sums,
        )
        self._clear()
        self._tick, self._faults = tick, faults
        self._shape = float(np.sqrt(np.mean(orbit**2))), float(np.abs(orbit).max())
        if good:
            self._good = tick
        self._window[:-1], self._goods[:-1] = self._window[1:].copy(), self._goods[1:].copy()
        self._window[-1], self._goods[-1] = 0, good

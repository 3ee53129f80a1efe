"""The loop without its runner: a policy against the plant in process, as fast as it goes."""

from collections.abc import Callable
from typing import Any

import numpy as np

from orbitfb.core.ports import Policy, inform
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.physics.plant import Plant

Supervisor = Callable[["ClosedLoop"], Policy | None]
"""Looks at a loop between two ticks; returns a policy to put in force, or None."""

_LOST = 5e-3


class ClosedLoop:
    """One plant under one policy, with everything that a learner may see.

    Args:
        plant: The ring; it is stepped here.
        policy: The policy to begin with.
        ticks: For how long records are kept [ticks].
        ramp: Ticks over which the gain grows to 1 at the start.
        valid: BPMs that count, shape (n,); None: all.

    Attributes:
        policy: In force.
        tick: Number of the next tick.
        lost: Whether the orbit passed 5 mm; then nothing is stepped any more.
        true_rms: Of the true orbit by tick, shape (ticks,) [m]; 5 mm once lost.
        observed_rms: Of the reading by tick, shape (ticks,) [m].
    """

    def __init__(
        self,
        plant: Plant,
        policy: Policy,
        ticks: int,
        ramp: int = 10,
        valid: Mask | None = None,
    ) -> None:
        n, m = plant.nominal_response.shape
        self.plant, self.tick, self.lost = plant, 0, False
        self.true_rms = np.full(ticks, _LOST)
        self.observed_rms = np.full(ticks, _LOST)
        self._ramp = ramp
        self._setpoints = np.zeros((ticks + 1, m))
        self._orbit = np.zeros((ticks, n))
        self._applied = np.zeros((ticks, m))
        self._policy_id = np.zeros(ticks, dtype="U64")
        self._valid = np.ones(n, dtype=np.bool_) if valid is None else valid
        self._policy, self._state = policy, policy.initial_state()

    @property
    def policy(self) -> Policy:
        """The one in force; another one begins with a state of its own."""
        return self._policy

    @policy.setter
    def policy(self, policy: Policy) -> None:
        if policy is not self._policy:
            self._policy, self._state = policy, policy.initial_state()

    @property
    def largest(self) -> float:
        """Largest setpoint of any corrector so far [A]."""
        return float(np.abs(self._setpoints[: self.tick + 1]).max())

    @property
    def policy_state(self) -> Any:
        """What the policy carries from tick to tick."""
        return self._state

    def run(self, supervisor: Supervisor | None = None, every: int = 20) -> "ClosedLoop":
        """Step to the end, or until the orbit is lost.

        Args:
            supervisor: May change the policy.
            every: Ticks between two of its looks.
        """
        while self.tick < len(self.true_rms) and not self.lost:
            self._step()
            if supervisor is not None and self.tick % every == 0:
                policy = supervisor(self)
                if policy is not None:
                    self.policy = policy
        return self

    def advance(self, ticks: int) -> None:
        """Step a number of ticks, or until the orbit is lost."""
        for _ in range(ticks):
            if self.tick < len(self.true_rms) and not self.lost:
                self._step()

    def transitions(self, since: int = 0) -> Transitions:
        """Give the transitions that begin at a tick or later."""
        begin, end = max(since, 0), self.tick - 1
        rows = slice(begin, max(end, begin))
        count = rows.stop - rows.start
        n, m = self._orbit.shape[1], self._applied.shape[1]
        time = np.linspace(0.0, 0.1 * count, count + 1) + 0.1 * rows.start
        return Transitions(
            tick=np.arange(rows.start, rows.stop),
            time=time[:-1],
            next_time=time[1:],
            written=time[:-1],
            orbit=self._orbit[rows],
            next_orbit=self._orbit[rows.start + 1 : rows.stop + 1],
            reference=np.zeros((count, n)),
            valid=np.tile(self._valid, (count, 1)),
            requested=self._applied[rows],
            applied=self._applied[rows],
            dither=np.zeros((count, m)),
            setpoints=self._setpoints[rows],
            readback=self._setpoints[rows],
            policy_id=self._policy_id[rows],
            closed=np.ones(count, dtype=np.bool_),
            hertz=np.zeros(count),
            usable=np.ones(count, dtype=np.bool_),
            auxiliary={},
        )

    def applied(self, since: int) -> Vector:
        """Changes that were applied at a tick or later, shape (T, m) [A]."""
        return self._applied[since : self.tick - 1]

    def _step(self) -> None:
        tick, setpoints = self.tick, self._setpoints[self.tick]
        state = self.plant.step(setpoints)
        change, self._state = self._policy.act(state.reading, self._valid, self._state)
        change = change * min(1.0, (tick + 1) / self._ramp)
        self._orbit[tick], self._applied[tick] = state.reading, change
        self._state = inform(self._policy, state.reading, self._valid, change, self._state)
        self._setpoints[tick + 1] = setpoints + change
        self._policy_id[tick] = self._policy.policy_id
        rms = float(np.sqrt(np.mean(state.true_orbit**2)))
        self.lost = rms > _LOST
        self.true_rms[tick] = min(rms, _LOST)
        self.observed_rms[tick] = min(float(np.sqrt(np.mean(state.reading**2))), _LOST)
        self.tick += 1

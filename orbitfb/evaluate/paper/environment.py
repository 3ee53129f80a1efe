"""The environment of the paper's experiment, for a batch of trajectories at once.

One trajectory has random numbers of its own, so that a batch may be cut in any way and be run
anywhere: trajectory 7 is the same alone, among 32 and in another process.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.scenarios import Scenario

_CHUNK = 20
_INITIAL, _READING, _MOTION, _AGAIN = range(1, 5)
_LOST = 5e-3


class Controller(Protocol):
    """Whatever controls N trajectories."""

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad], for the readings, shape (N, n) [m]."""
        ...


class Environment:
    """N rings under a drift.

    Args:
        scenario: What happens.
        trajectories: Numbers of the trajectories, from 0.

    Attributes:
        scenario: What happens.
        trajectories: Their numbers.
        true: The true orbits, shape (N, n) [m].
        tick: Number of the present tick.
    """

    def __init__(self, scenario: Scenario, trajectories: Sequence[int]) -> None:
        self.scenario = scenario
        self.trajectories = tuple(trajectories)
        n, m = scenario.start.shape
        self.tick = 0
        self._readings = [scenario.generator(t, _READING) for t in trajectories]
        self._motions = [scenario.generator(t, _MOTION) for t in trajectories]
        self._kicks = [scenario.generator(t, _AGAIN) for t in trajectories]
        first = [scenario.generator(t, _INITIAL).standard_normal(n) for t in trajectories]
        self._free = _scaled(np.array(first), scenario.initial)
        self._setpoints = np.zeros((len(first), m))
        self._noise = self._motion = np.empty((0, 0, 0))
        self.true = self._free.copy()

    def observe(self) -> Vector:
        """Read the orbits, shape (N, n) [m]; once a tick."""
        if self.tick % _CHUNK == 0:
            self._draw()
        return self.true + self.scenario.reading_noise * self._noise[:, self.tick % _CHUNK]

    def step(self, changes: Vector) -> None:
        """Apply changes of the kicks, shape (N, m) [rad], and go on by a tick."""
        scenario = self.scenario
        if scenario.physical:
            self._setpoints += changes
            self._free += self._walk()
            response = scenario.response(self.tick + 1)
            self.true = self._free + self._setpoints @ response.T
        else:
            self.true = self.true + changes @ scenario.response(self.tick).T
            self.true += self._walk()
        self.tick += 1

    def kick(self) -> None:
        """Add the white re-kick to every orbit."""
        n = self.true.shape[1]
        drawn = np.array([g.standard_normal(n) for g in self._kicks])
        kick = _scaled(drawn, self.scenario.initial)
        self._free += kick
        self.true = self.true + kick

    def _walk(self) -> Vector | float:
        scenario = self.scenario
        if scenario.walk is None and scenario.white == 0.0:
            return 0.0
        n = len(scenario.start)
        drawn = self._motion[:, self.tick % _CHUNK]
        moved = scenario.white * drawn[:, :n]
        return moved if scenario.walk is None else moved + drawn[:, n:] @ scenario.walk.T

    def _draw(self) -> None:
        scenario = self.scenario
        n = len(scenario.start)
        self._noise = np.array([g.standard_normal((_CHUNK, n)) for g in self._readings])
        width = n + (0 if scenario.walk is None else scenario.walk.shape[1])
        if scenario.walk is not None or scenario.white:
            self._motion = np.array([g.standard_normal((_CHUNK, width)) for g in self._motions])


def _scaled(orbits: Vector, rms: float) -> Vector:
    """Scale every orbit to an rms."""
    return orbits * (rms / np.sqrt(np.mean(orbits**2, axis=1, keepdims=True)))


@dataclass(frozen=True, slots=True)
class Curves:
    """What a batch of trajectories showed; the re-kick comes at tick `steps`.

    Args:
        observed: Rms of the readings, shape (N, steps + after + 1) [m].
        true: Rms of the true orbits, the same shape [m].
        lost: Trajectories that passed 5 mm: their orbits stay at 5 mm from there, shape (N,).
    """

    observed: Vector
    true: Vector
    lost: np.ndarray


def simulate(
    scenario: Scenario,
    trajectories: Sequence[int],
    control: Callable[[Environment], Controller],
) -> Curves:
    """Run a batch from the first orbit over the drift and the re-kick.

    Args:
        scenario: What happens.
        trajectories: Numbers of the trajectories.
        control: Makes the controller. It is given the environment, so that the bound may look at
            R_t; any other controller uses only `environment.scenario.known`.
    """
    environment = Environment(scenario, trajectories)
    controller = control(environment)
    length = scenario.steps + scenario.after + 1
    observed = np.full((len(trajectories), length), _LOST)
    true = observed.copy()
    alive = np.ones(len(trajectories), dtype=np.bool_)
    for tick in range(length):
        if tick == scenario.steps:
            environment.kick()
        reading = environment.observe()
        rms = np.sqrt(np.mean(environment.true**2, axis=1))
        alive &= rms < _LOST  # a NaN is lost too
        observed[alive, tick] = np.sqrt(np.mean(reading[alive] ** 2, axis=1))
        true[alive, tick] = rms[alive]
        if not alive.any():
            break
        changes = controller.act(np.where(alive[:, None], reading, 0.0), tick)
        environment.step(np.where(alive[:, None], changes, 0.0))
    return Curves(observed, true, ~alive)

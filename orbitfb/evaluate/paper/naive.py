"""The paper's refit, as it stands: least squares of s_{n+1} − s_n on a_n, from closed-loop data.

Every 500 ticks the R of each trajectory is estimated from its last 500 transitions and the law
is made anew from it: the SVD law, or the network of Algorithm 1, trained on from its own weights.
What is wrong with that is told in `models.naive`; here it is shown.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from orbitfb.core.errors import TrainingError
from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.laws import Each, EachLinear, Memoryless, known_responses
from orbitfb.evaluate.paper.scenarios import PAPER_LAMBDA
from orbitfb.evaluate.paper.trained import training_of
from orbitfb.models.naive import naive_least_squares
from orbitfb.models.rows import Rows
from orbitfb.policies.inverse import regularised_inverse
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.training.trajectory import train_trajectory
from orbitfb.policies.training.trajectory_settings import TrajectorySettings

_EVERY = 500
_CHANGE = 1e-3
_FINE_TUNE = 20


class Recorder:
    """Keeps the last block of readings and changes of every trajectory."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        count, n, m = shape
        self._readings = np.zeros((_EVERY + 1, count, n))
        self._changes = np.zeros((_EVERY + 1, count, m))

    def add(self, tick: int, observed: Vector) -> bool:
        """Take a reading; say whether a block of transitions is full."""
        place = tick % _EVERY
        full = tick > 0 and place == 0
        if full:
            self._readings[_EVERY] = observed
        else:
            self._readings[place] = observed
        return full

    def changed(self, tick: int, changes: Vector) -> None:
        """Take the changes that answered the reading."""
        self._changes[tick % _EVERY] = changes

    def begin(self, observed: Vector) -> None:
        """Begin a block with the reading that ended the one before."""
        self._readings[0] = observed

    def estimate(self, trajectory: int) -> Vector | None:
        """Estimate R from a full block; None when nothing was changed."""
        changes = self._changes[:_EVERY, trajectory]
        if not np.any(changes):
            return None
        return naive_response(self._readings[:, trajectory], changes)


def naive_response(readings: Vector, changes: Vector) -> Vector:
    """Estimate R as the paper does.

    Args:
        readings: Shape (T + 1, n) [m].
        changes: Shape (T, m) [rad].

    Returns:
        R̂, shape (n, m) [m/rad].
    """
    count, n = len(changes), readings.shape[1]
    rows = Rows(
        tick=np.arange(count),
        change=changes,
        dither=np.zeros_like(changes),
        difference=np.diff(readings, axis=0),
        valid=np.ones((count, n), dtype=np.bool_),
        starts=np.arange(count) == 0,
        closed=np.ones(count, dtype=np.bool_),
        left_out={},
    )
    return naive_least_squares(rows)


class NaiveRefit:
    """The SVD law, made anew from naive estimates.

    Args:
        environment: The trajectories.
        regularisation: λ [(m/rad)²].
        gain: Of every mode [1].
    """

    def __init__(
        self, environment: Environment, regularisation: float = PAPER_LAMBDA, gain: float = 1.0
    ) -> None:
        self._lambda, self._gain = float(np.sqrt(regularisation)), gain
        known = known_responses(environment)
        self._inverses = np.array([self._inverse(response) for response in known])
        self._laws = EachLinear(self._inverses)
        count, n, m = known.shape
        self._record = Recorder((count, n, m))

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        if self._record.add(tick, observed):
            for trajectory in range(len(observed)):
                estimate = self._record.estimate(trajectory)
                if estimate is not None:
                    self._inverses[trajectory] = self._inverse(estimate)
            self._laws = EachLinear(self._inverses)
            self._record.begin(observed)
        changes = self._laws.act(observed, tick)
        self._record.changed(tick, changes)
        return changes

    def _inverse(self, response: Vector) -> Vector:
        return self._gain * regularised_inverse(response, self._lambda)


class Verbatim:
    """Algorithm 1 in its plain form, and its network trained on with naive estimates.

    The network is trained on the R that the controller of trajectory 0 starts from. A training
    that ends in numbers that are not finite leaves the network as it was.

    Args:
        environment: The trajectories.
        device: `auto`, `cpu` or `cuda`.

    Attributes:
        training: Curve and figures of the first training, as JSON.
    """

    def __init__(self, environment: Environment, device: str) -> None:
        scenario = environment.scenario
        first = train_trajectory(
            scenario.known(0), TrajectorySettings.paper(change_scale=_CHANGE), device=device
        )
        self.training: Mapping[str, Any] = training_of(first)
        self._again = TrajectorySettings.paper(change_scale=_CHANGE, iterations=_FINE_TUNE)
        self._device = device
        count = len(environment.trajectories)
        self._networks: list[NetworkPolicy] = [first.policy] * count
        self._record = Recorder((count, *scenario.start.shape))

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        if self._record.add(tick, observed):
            for trajectory in range(len(observed)):
                self._refit(trajectory)
            self._record.begin(observed)
        first = self._networks[0]
        if all(network is first for network in self._networks):
            changes = first.changes(observed)
        else:
            laws: list[Memoryless] = [*self._networks]
            changes = Each(laws).act(observed, tick)
        self._record.changed(tick, changes)
        return changes

    def _refit(self, trajectory: int) -> None:
        estimate = self._record.estimate(trajectory)
        if estimate is None:
            return
        try:
            result = train_trajectory(
                estimate,
                self._again,
                start=self._networks[trajectory],
                device=self._device,
            )
        except TrainingError:
            return
        self._networks[trajectory] = result.policy

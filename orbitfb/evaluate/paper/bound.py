"""The bound: a controller that knows R_t, all setpoints and the statistics of all noise.

A Kalman filter along the eigenvectors of the covariance of the orbit's steps predicts the orbit;
the change takes away all that is predicted, including what the drift of R does to the setpoints.
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment

_REGULARISATION = 1e-3
"""λ [m/rad]."""


class TrueResponse:
    """Knows what the ring does.

    Where a mode of R_t changes its sign no change reaches it; a small λ keeps the setpoints from
    growing there, and what is left stays in the prediction.

    Args:
        environment: The trajectories.
    """

    def __init__(self, environment: Environment) -> None:
        scenario = environment.scenario
        n, m = scenario.start.shape
        count = len(environment.trajectories)
        covariance = scenario.white**2 * np.eye(n)
        if scenario.walk is not None:
            covariance += scenario.walk @ scenario.walk.T
        steps, self._modes = np.linalg.eigh(covariance)
        self._steps = np.clip(steps, 0.0, None)
        self._variance = np.full(n, scenario.initial**2)
        self._predicted = np.zeros((count, n))
        self._setpoints = np.zeros((count, m))
        self._scenario = scenario

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        scenario = self._scenario
        if tick == scenario.steps:
            self._variance += scenario.initial**2
        gains = self._variance / (self._variance + scenario.reading_noise**2)
        innovation = (observed - self._predicted) @ self._modes
        orbit = self._predicted + (innovation * gains) @ self._modes.T
        self._variance = (1.0 - gains) * self._variance + self._steps
        response = scenario.response(tick + 1 if scenario.physical else tick)
        if scenario.physical:
            orbit += self._setpoints @ (response - scenario.response(tick)).T
        damped = response.T @ response
        damped.flat[:: len(damped) + 1] += _REGULARISATION**2
        solved = np.linalg.solve(damped, response.T @ orbit.T)
        changes = np.asarray(-solved.T, dtype=np.float64)
        self._setpoints += changes
        self._predicted = orbit + changes @ response.T
        return changes

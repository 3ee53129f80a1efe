"""Simulate what no recursion of covariances predicts: the loop under a law that is not linear.

Many loops run side by side, on responses drawn from the posterior, under the reading noise and
the ground motion that the innovations show. Every law sees the same responses and the same
noise, so that a difference between two laws is not one of luck. A change that is decided on one
orbit is in the next one, as at the machine.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.models.linear import LinearModel

_LOST = 1.0


@runtime_checkable
class BatchPolicy(Protocol):
    """A law without memory that decides on many orbits at once."""

    def changes(self, errors: Vector) -> Vector:
        """Decide on orbit errors (..., n) [m]; gives changes (..., m) [A]."""
        ...


@dataclass(frozen=True, slots=True)
class Scene:
    """What all laws are simulated on.

    Args:
        responses: Responses drawn, shape (S, n, m) [m/A].
        model: Reading noise, ground motion and creep.
        ticks: Length of the run at rest [ticks].
        kick: White orbit error at the start of the run after a kick, rms [m].
        kick_ticks: Length of that run [ticks].
        seed: Of the noise.
    """

    responses: Vector
    model: LinearModel
    ticks: int
    kick: float
    kick_ticks: int
    seed: int


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of the loops.

    Args:
        rms: True orbit at rest, rms over the last three quarters of the run [m].
        worst: The same for the worst response [m].
        peak: Largest true orbit after the kick, rms over the kick, worst response [1].
        left: True orbit at the end of that run over the kick, worst response [1].
        each: True orbit at rest on each response, rms, shape (S,) [m].
    """

    rms: float
    worst: float
    peak: float
    left: float
    each: Vector


def simulate(policy: BatchPolicy, scene: Scene) -> Outcome:
    """Run the loops under a law.

    Args:
        policy: The law.
        scene: Responses, noise, lengths.
    """
    quiet = _run(policy, scene, scene.ticks, 0.0)
    settled = np.mean(quiet[scene.ticks // 4 :] ** 2, axis=0)
    kicked = _run(policy, scene, scene.kick_ticks, scene.kick) / scene.kick
    return Outcome(
        rms=float(np.sqrt(np.mean(settled))),
        worst=float(np.sqrt(np.max(settled))),
        peak=float(np.max(kicked)),
        left=float(np.max(kicked[-1])),
        each=np.sqrt(settled),
    )


def _run(policy: BatchPolicy, scene: Scene, ticks: int, kick: float) -> Vector:
    """Give the rms of the true orbit after every tick on every response, shape (ticks, S) [m]."""
    model, responses = scene.model, scene.responses
    generator = np.random.default_rng(scene.seed)
    shape = responses.shape[:2]
    reading = np.sqrt(model.reading_variance)
    steps = np.sqrt(model.ground_variances)
    orbit = kick * generator.standard_normal(shape)
    kept = np.ones(shape[0], dtype=np.bool_)
    rms = np.full((ticks, shape[0]), _LOST)
    for tick in range(ticks):
        read = orbit + reading * generator.standard_normal(shape)
        change = policy.changes(read)
        ground = steps * generator.standard_normal(shape) + model.creep
        orbit = orbit + (responses @ change[:, :, None])[:, :, 0] + ground @ model.modes.T
        size = np.sqrt(np.mean(orbit**2, axis=1))
        kept &= size < _LOST  # not so for a NaN
        orbit[~kept] = 0.0
        rms[tick, kept] = size[kept]
    return rms

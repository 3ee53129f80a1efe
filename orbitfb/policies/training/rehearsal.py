"""A memoryless policy in closed loop on linear responses: what a training came to."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orbitfb.core.signals import Vector


class Memoryless(Protocol):
    """A policy without a state, for many orbits at once."""

    def changes(self, errors: Vector) -> Vector:
        """Give changes, shape (..., m) [A], for orbit errors of shape (..., n) [m]."""
        ...


@dataclass(frozen=True, slots=True)
class Rehearsal:
    """What is tried.

    Args:
        amplitude: Rms of the first orbits, white [m].
        reading_noise: Noise of the readings, rms [m].
        orbit_noise: White motion of the orbit between two steps, rms [m].
        steps: Length [1].
        seed: Seed of orbits and noise; two policies with the same seed see the same.
    """

    amplitude: float = 0.25e-3
    reading_noise: float = 0.2e-6
    orbit_noise: float = 0.0
    steps: int = 60
    seed: int = 0


def rehearse(policy: Memoryless, responses: Vector, rehearsal: Rehearsal) -> Vector:
    """Run a policy on several rings, a trajectory on each.

    Args:
        policy: The policy.
        responses: The true R of each, shape (S, n, m) [m/A].
        rehearsal: What is tried.

    Returns:
        Rms of the true orbit, shape (steps + 1, S) [m]; inf from where it is not finite.
    """
    rng = np.random.default_rng([rehearsal.seed, 0x7265])
    shape = responses.shape[:2]
    orbit = rehearsal.amplitude * rng.standard_normal(shape)
    curve = np.full((rehearsal.steps + 1, len(responses)), np.inf)
    curve[0] = np.sqrt(np.mean(orbit**2, axis=1))
    transposed = np.swapaxes(responses, 1, 2)
    with np.errstate(all="ignore"):
        for step in range(1, rehearsal.steps + 1):
            read = orbit + rehearsal.reading_noise * rng.standard_normal(shape)
            orbit = orbit + (policy.changes(read)[:, None, :] @ transposed)[:, 0]
            orbit += rehearsal.orbit_noise * rng.standard_normal(shape)
            rms = np.sqrt(np.mean(orbit**2, axis=1))
            if not np.isfinite(rms).all():
                break
            curve[step] = rms
    return curve


@dataclass(frozen=True, slots=True)
class Verdict:
    """What a policy came to in closed loop on the samples.

    Args:
        score: Mean over steps and samples of log(rms / first rms) [1]; lower is better.
        floor: Rms of the true orbit over the last half, samples in squares [m].
        worst: Largest rms of the true orbit after the first step [m].
    """

    score: float
    floor: float
    worst: float

    def better_than(self, other: "Verdict", tolerance: float) -> bool:
        """Better over all, and floor and worst at most `tolerance` times those of the other."""
        return (
            self.score < other.score
            and self.floor <= tolerance * other.floor
            and self.worst <= tolerance * other.worst
        )


def judge(policy: Memoryless, responses: Vector, trial: Rehearsal) -> Verdict:
    """Run a policy in closed loop on responses, shape (S, n, m) [m/A], and sum up."""
    curve = rehearse(policy, responses, trial)
    late = curve[len(curve) // 2 :]
    with np.errstate(divide="ignore"):
        score = float(np.mean(np.log(curve[1:] / curve[0])))
    return Verdict(score, float(np.sqrt(np.mean(late**2))), float(np.max(curve[1:])))


def spectral_radius(gain_matrix: Vector, response: Vector) -> float:
    """Largest |eigenvalue| of a step of the loop near zero, 1 − R K, where R reaches [1].

    Args:
        gain_matrix: K of a policy, its slope at zero with the sign turned, shape (m, n) [A/m].
        response: R, shape (n, m) [m/A].
    """
    fewer_bpms = len(response) <= len(gain_matrix)
    loop = response @ gain_matrix if fewer_bpms else gain_matrix @ response
    return float(np.max(np.abs(1.0 - np.linalg.eigvals(loop))))

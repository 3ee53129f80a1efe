"""Modes that share the covariance of their rows of R, for the estimate beside this module."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns
from orbitfb.estimation.recursive.settings import RecursiveSettings


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """What is known beforehand of modes that share the covariance of their coefficients θ.

    Args:
        members: The modes.
        rows: θ̂ of every mode, shape (members, k).
        covariance: P = cov(θ), shape (k, k).
        drift: What a tick adds to the diagonal of P beyond what it adds in every group, (k,).
        step: Variance of the random step of a mode of this group [m²].
    """

    members: slice
    rows: Vector
    covariance: Vector
    drift: Vector
    step: float

    @property
    def size(self) -> int:
        """Count of the modes."""
        return self.members.stop - self.members.start


def make_groups(
    rows: Vector, columns: Columns, response: Vector, steps: Vector, settings: RecursiveSettings
) -> tuple[list[Group], Vector]:
    """Say of every group of modes what is known beforehand.

    Relative errors are gains of BPMs and of correctors: of the element (i, j) of UᵀRV they make
    the variance relative² (σ_i² + σ_j²) / n, so that the row of a weak mode is known much better
    than that of a strong one.

    Args:
        rows: Uᵀ of the whole response, modes from the strongest, shape (n, actuators).
        columns: The actuators, m of them correctors.
        response: The whole response, shape (n, actuators).
        steps: Variance of the random step of every mode, shape (n,) [m²].
        settings: Prior and drift.

    Returns:
        The groups, and what a tick adds to the covariance of every one of them, shape (k, k).
    """
    n, count, m = len(rows), columns.actuators, columns.correctors
    creeping = int(settings.creep > 0.0)
    power = np.sum(rows[:, :m] ** 2, axis=1)

    def share(entry: float, gains: float, rf: float) -> Vector:
        return np.pad(columns.prior(response, entry, gains, rf), (0, creeping))

    prior = share(settings.prior_entry, settings.prior_relative, settings.rf_error)
    groups: list[Group] = []
    for part in _cut(power, settings.groups):
        strength = float(np.mean(power[part])) / n
        start, drift = prior.copy(), np.zeros(count)
        start.flat[: m * len(start) : len(start) + 1] += settings.prior_relative**2 * strength
        drift[:m] = settings.drift_relative**2 * strength
        if creeping:
            creep = settings.creep**2 * _middle(power[part]) / float(np.mean(power))
            creep += settings.creep_white**2
            if count > m:  # an energy that drifts moves the orbit as so many Hz a tick would
                energy = rows[part, m] * settings.rf_creep / columns.unit
                creep += float(np.mean(energy**2))
            start[count, count] = creep
            drift = np.append(drift, creep / settings.creep_memory)
        groups.append(
            Group(
                members=part,
                rows=np.pad(rows[part], ((0, 0), (0, creeping))),
                covariance=start,
                drift=drift,
                step=_middle(steps[part]),
            )
        )
    return groups, share(settings.drift_entry, settings.drift_relative, 0.0)


def step_variances(rows: Vector, settings: RecursiveSettings) -> Vector:
    """Variance of every mode's random step [m²]: ground as kicks make it, white, and a floor.

    Args:
        rows: UᵀR, shape (n, m).
        settings: Of noise and ground.
    """
    power = np.sum(rows**2, axis=1)
    gain = settings.minimum_gain
    steps = settings.ground**2 * power / np.mean(power) + settings.white**2
    return np.maximum(steps, gain**2 / (1.0 - gain) * settings.reading_noise**2)


def _middle(values: Vector) -> float:
    """Give the geometric mean."""
    return float(np.exp(np.mean(np.log(np.maximum(values, np.finfo(np.float64).tiny)))))


def _cut(power: Vector, groups: int) -> list[slice]:
    """Cut the modes, strongest first, into groups of like strength."""
    n = len(power)
    height = np.log(np.maximum(power, 1e-12 * power[0]))
    edges = np.linspace(height[0], height[-1], groups + 1)[1:-1]
    cuts = sorted({0, n, *(int(np.sum(height > edge)) for edge in edges)})
    return [slice(a, b) for a, b in pairwise(cuts)]

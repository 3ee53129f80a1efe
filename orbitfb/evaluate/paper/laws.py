"""Static laws for a batch of trajectories at once.

Where every trajectory starts from its own R, each has a law of its own; where R1 is known exactly
they share one, and a tick is one product of matrices.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.scenarios import PAPER_LAMBDA
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings


class Memoryless(Protocol):
    """A law whose changes depend on the present orbit alone."""

    def changes(self, errors: Vector) -> Vector:
        """Give changes, shape (..., m), for orbits, shape (..., n) [m]."""
        ...


class Shared:
    """One law for all trajectories."""

    def __init__(self, law: Memoryless) -> None:
        self._law = law

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        return self._law.changes(observed)


class Each:
    """A law for each trajectory."""

    def __init__(self, laws: Sequence[Memoryless]) -> None:
        self._laws = laws

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        rows = zip(self._laws, observed, strict=True)
        return np.array([law.changes(row) for law, row in rows])


class EachLinear:
    """A linear law a = −K y for each trajectory.

    Single precision: the products wait for memory, and a law that reads 0.2 µm of noise does not
    see its 24 bits.

    Args:
        gain_matrices: K, shape (N, m, n) [rad/m].
    """

    def __init__(self, gain_matrices: Vector) -> None:
        self._gain_matrices = -gain_matrices.astype(np.float32)

    def act(self, observed: Vector, tick: int) -> Vector:
        """Give the changes, shape (N, m) [rad]."""
        readings = observed.astype(np.float32)
        return np.matmul(self._gain_matrices, readings[:, :, None])[:, :, 0].astype(np.float64)


def known_responses(environment: Environment) -> Vector:
    """Give the R that every trajectory's controller starts from, shape (N, n, m) [m/rad]."""
    scenario = environment.scenario
    return np.array([scenario.known(trajectory) for trajectory in environment.trajectories])


def svd(
    environment: Environment, regularisation: float = PAPER_LAMBDA, gain: float = 1.0
) -> Shared | EachLinear:
    """Make the paper's law, a = −gain (RᵀR + λ I)⁻¹ Rᵀ y, with the R known at the start.

    Args:
        environment: The trajectories.
        regularisation: λ [(m/rad)²].
        gain: Of every mode [1].
    """
    settings = SvdSettings(gain=gain, regularisation=float(np.sqrt(regularisation)))
    if environment.scenario.error_entry == 0.0:
        return Shared(SvdPolicy(environment.scenario.start, settings))
    laws = [SvdPolicy(known, settings).gain_matrix for known in known_responses(environment)]
    return EachLinear(np.array(laws))


def modal_linear(environment: Environment) -> EachLinear:
    """Make the strong linear baseline: of every mode the Kalman gain, cautious where R is doubted.

    It knows the noise of readings, ground and the first R; nothing of the drift.

    Args:
        environment: The trajectories.
    """
    return EachLinear(np.array([law.gain_matrix for law in _modal(environment, None)]))


def modal(environment: Environment) -> Each:
    """Make the same law with full gain far from zero, what the network embeds.

    Args:
        environment: The trajectories.
    """
    return Each(_modal(environment, ModalSettings().threshold))


def _modal(environment: Environment, threshold: float | None) -> list[ModalPolicy]:
    scenario = environment.scenario
    n, m = scenario.start.shape
    ground = 0.0 if scenario.walk is None else float(np.linalg.norm(scenario.walk) / np.sqrt(n))
    settings = ModalSettings(
        reading_noise=scenario.reading_noise, ground=ground, threshold=threshold
    )
    doubt = scenario.error_entry**2 * np.eye(m)
    return [
        ModalPolicy(known, settings, covariance=doubt) for known in known_responses(environment)
    ]

"""How every kind of policy is made: at first of a response, then of a posterior and an incumbent.

- svd: Tikhonov's inverse of R̂, cautious where R̂ is not known;
- modal: the same inverse with the Kalman gain that the innovations show for every mode;
- network: that law in the paper's network, only the last matrix new where the modes stay;
- supervised: the network, trained on the answers of the modal law from the incumbent's weights;
- trajectory: the network, improved on responses drawn from the posterior. The incumbent's hidden
  layers stay where they fit, so that a swap changes one matrix.
"""

from typing import Protocol

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Mask, Vector
from orbitfb.learn.judge import gain_of
from orbitfb.learn.learner import Build
from orbitfb.models.linear import LinearModel
from orbitfb.models.noise import LADDER
from orbitfb.policies.embedding import embed, reembed
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.svd import SvdPolicy


class ResponsePolicy(Policy, Protocol):
    """What every kind has besides the port: the response that it was made for."""

    @property
    def response(self) -> Vector:
        """R, shape (n, m) [m/A]."""
        ...


def first_policy(
    response: Vector, settings: PolicySettings, movable: Mask | None = None
) -> ResponsePolicy:
    """Make the policy that a loop begins with.

    Args:
        response: R, shape (n, m) [m/A].
        settings: The kind and its settings.
        movable: Correctors that may move, shape (m,); None: all.
    """
    if settings.kind == "svd":
        return masked(SvdPolicy(response, settings.svd), movable)
    law = ModalPolicy(response, settings.modal)
    if settings.kind == "modal":
        return masked(law, movable)
    return masked(embed(law, settings.network), movable)


def masked(policy: ResponsePolicy, movable: Mask | None) -> ResponsePolicy:
    """Let a policy leave the masked correctors alone; it is the same one when none is."""
    if movable is None or movable.all():
        return policy
    return MaskedPolicy(policy, policy.response, movable)


def loop_gain(policy: ResponsePolicy) -> float:
    """Give the mean gain of the modes near zero, mean diagonal of R K, from 0 to below 2 [1]."""
    size = len(policy.response)
    gain = float(np.sum(policy.response * gain_of(policy, size).T)) / size
    return min(max(gain, 0.0), 1.9)


def unmasked(policy: Policy) -> Policy:
    """Give the policy inside."""
    while isinstance(policy, MaskedPolicy):
        policy = policy.policy
    return policy


def builder(settings: PolicySettings, movable: Mask | None = None, seed: int = 0) -> Build:
    """Give what makes the candidates of a kind.

    Args:
        settings: The kind and its settings.
        movable: Correctors that may move, shape (m,); None: all.
        seed: Of what a training draws.

    Raises:
        ConfigError: There is no such kind.
    """
    kinds = {
        "svd": _svd,
        "modal": modal_law,
        "network": _network,
        "trajectory": _Trajectory(seed),
    }
    if settings.kind not in kinds:
        raise ConfigError(f"policy.kind is {settings.kind!r}; choose one of {', '.join(kinds)}")
    make = kinds[settings.kind]
    return lambda model, incumbent: masked(make(model, unmasked(incumbent), settings), movable)


def _svd(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> SvdPolicy:
    covariance = model.row_covariance if settings.cautious else None
    return SvdPolicy(model.response, settings.svd, covariance=covariance)


def modal_law(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> ModalPolicy:
    """Make the noise-aware law of a posterior.

    Args:
        model: The posterior of R and the noise.
        incumbent: Not asked.
        settings: Of the modal law.
    """
    modal = settings.modal
    gains = np.maximum(LADDER[model.levels], modal.minimum_gain)
    reading = float(np.sqrt(model.reading_variance))
    thresholds = np.inf if modal.threshold is None else _rounded(modal.threshold * reading)
    return ModalPolicy(
        model.response,
        modal,
        modes=model.modes,
        gains=gains,
        thresholds=thresholds,
        covariance=model.row_covariance if settings.cautious else None,
    )


def _network(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> NetworkPolicy:
    law = modal_law(model, incumbent, settings)
    if isinstance(incumbent, NetworkPolicy) and incumbent.settings == settings.network:
        try:
            return reembed(incumbent, law)
        except ConfigError:  # other modes or thresholds: its hidden layers do not fit
            pass
    return embed(law, settings.network)


class _Trajectory:
    """Improves the network of the posterior on responses drawn from it."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._made = 0

    def __call__(
        self, model: LinearModel, incumbent: Policy, settings: PolicySettings
    ) -> NetworkPolicy:
        return _network(model, incumbent, settings)


def _rounded(threshold: float) -> float:
    """Round to steps of 10 %, so that hidden layers stay while the noise estimate wavers."""
    step = np.log(1.1)
    return float(np.exp(step * np.round(np.log(threshold) / step)))

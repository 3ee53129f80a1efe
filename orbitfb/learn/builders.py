"""How every kind of policy is made: at first of a response, then of a posterior and an incumbent.

- svd: Tikhonov's inverse of R̂, cautious where R̂ is not known;
- modal: the same inverse with the Kalman gain that the innovations show for every mode;
- adaptive: a cautious gain on the filtered orbit, both tracked at every tick;
- network: that law in the paper's network, only the last matrix new where the modes stay;
- supervised: the network, trained anew on the answers of the modal law;
- a kind of another package: what it makes of R̂;
- trajectory: the network, improved on responses drawn from the posterior. The incumbent's hidden
  layers stay where they fit, so that a swap changes one matrix.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.ports import Policy
from orbitfb.core.signals import Mask, Vector
from orbitfb.learn.judge import gain_of
from orbitfb.models.linear import LinearModel
from orbitfb.models.noise import LADDER
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.embedding import embed, reembed
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.store.kinds import TAKEN
from orbitfb.policies.svd import SvdPolicy

if TYPE_CHECKING:
    from orbitfb.learn.learner import Build

_GROUPS = 4
"""Groups of responses that a fine-tuning goes round."""


class ResponsePolicy(Policy, Protocol):
    """What every kind has besides the port: the response that it was made for."""

    @property
    def response(self) -> Vector:
        """R, shape (n, m) [m/A]."""
        ...


def first_policy(
    response: Vector,
    settings: PolicySettings,
    movable: Mask | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> ResponsePolicy:
    """Make the policy that a loop begins with.

    Args:
        response: R, shape (n, m) [m/A].
        settings: The kind and its settings.
        movable: Correctors that may move, shape (m,); None: all.
        progress: Told iterations done and loss, where the kind is trained: supervised.
    """
    if settings.kind not in TAKEN:
        return masked(_added(response, settings), movable)
    if settings.kind == "svd":
        return masked(SvdPolicy(response, settings.svd), movable)
    if settings.kind == "adaptive":
        return masked(AdaptivePolicy(response, settings.adaptive), movable)
    law = ModalPolicy(response, settings.modal)
    if settings.kind == "modal":
        return masked(law, movable)
    if settings.kind == "supervised":
        from orbitfb.policies.training.supervised import train_supervised

        taught = train_supervised(
            response, settings.supervised, teacher=law, device="cpu", progress=progress
        )
        return masked(taught.policy, movable)
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


def remasked(policy: Policy, movable: Mask) -> ResponsePolicy:
    """Let a policy move these correctors and no others, whatever it moved before.

    Args:
        policy: That of the service, which has a response.
        movable: Correctors that may move, shape (m,).
    """
    inside: Any = unmasked(policy)
    return masked(inside, movable)


def builder(settings: PolicySettings, movable: Mask | None = None, seed: int = 0) -> "Build":
    """Give what makes the candidates of a kind.

    Args:
        settings: The kind and its settings.
        movable: Correctors that may move, shape (m,); None: all.
        seed: Of what a training draws.
    """
    kinds = {
        "svd": _svd,
        "modal": modal_law,
        "adaptive": _adaptive,
        "network": _network,
        "supervised": _supervised,
        "trajectory": _Trajectory(seed),
    }
    make = kinds.get(settings.kind, _of_response)
    return lambda model, incumbent: masked(make(model, unmasked(incumbent), settings), movable)


def _added(response: Vector, settings: PolicySettings) -> ResponsePolicy:
    """Make a policy of a kind that another package adds."""
    kind, own = settings.added()
    if kind.begin is None:
        raise ConfigError(f"policy.kind: {kind.word} has no `begin`, so that no loop can run it")
    return kind.begin(response, own)


def _of_response(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> ResponsePolicy:
    return _added(model.response, settings)


def _svd(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> SvdPolicy:
    return SvdPolicy(model.response, settings.svd, covariance=_doubt(model, settings))


def _doubt(model: LinearModel, settings: PolicySettings) -> Vector | None:
    """Give the covariance of a row of R̂ that a law is to be cautious of, shape (m, m)."""
    return settings.caution * model.row_covariance if settings.caution > 0.0 else None


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
        covariance=_doubt(model, settings),
    )


def _adaptive(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> AdaptivePolicy:
    """Begin anew with what the rows of the record say, all groups alike."""
    own = settings.adaptive
    covariances = [model.row_covariance] * own.tracking.groups
    return AdaptivePolicy(model.response, own, covariances)


def _network(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> NetworkPolicy:
    law = modal_law(model, incumbent, settings)
    if isinstance(incumbent, NetworkPolicy) and incumbent.settings == settings.network:
        try:
            return reembed(incumbent, law)
        except ConfigError:  # other modes or thresholds: its hidden layers do not fit
            pass
    return embed(law, settings.network)


class _Trajectory:
    """Improves the better of two networks on responses drawn from the posterior.

    One is the incumbent as it is, the other the law of the posterior in its hidden layers. What
    the training makes is kept only if it is better than its start.
    """

    def __init__(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed)

    def __call__(
        self, model: LinearModel, incumbent: Policy, settings: PolicySettings
    ) -> NetworkPolicy:
        from orbitfb.policies.training.fine_tune import (
            fine_tune,  # torch: here and in no loop's process
        )
        from orbitfb.policies.training.rehearsal import Rehearsal, judge

        tuning = settings.fine_tune.model_copy(
            update={
                "reading_noise": float(np.sqrt(model.reading_variance)),
                "orbit_noise": float(np.sqrt(np.mean(model.ground_variances))),
                "seed": int(self._generator.integers(2**31)),
            }
        )
        count = tuning.samples_per_iteration * _GROUPS + tuning.judged_samples
        samples = np.stack([model.sample(self._generator) for _ in range(count)])
        start = _network(model, incumbent, settings)
        if isinstance(incumbent, NetworkPolicy):
            trial = Rehearsal(
                amplitude=tuning.amplitude,
                reading_noise=tuning.reading_noise,
                orbit_noise=tuning.orbit_noise,
                steps=tuning.judged_steps,
                seed=tuning.seed,
            )
            judged = samples[: tuning.samples_per_iteration]
            if judge(incumbent, judged, trial).better_than(
                judge(start, judged, trial), tuning.floor_tolerance
            ):
                start = incumbent
        return fine_tune(start, samples, tuning, response=model.response).policy


def _supervised(model: LinearModel, incumbent: Policy, settings: PolicySettings) -> NetworkPolicy:
    from orbitfb.policies.training.supervised import train_supervised

    teacher = modal_law(model, incumbent, settings)
    result = train_supervised(model.response, settings.supervised, teacher=teacher, device="cpu")
    return result.policy


def _rounded(threshold: float) -> float:
    """Round to steps of 10 %, so that hidden layers stay while the noise estimate wavers."""
    step = np.log(1.1)
    return float(np.exp(step * np.round(np.log(threshold) / step)))

"""Train a policy and store it with its card."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from orbitfb.app.setup.stored_policies import activate_stored, data_hash, open_store
from orbitfb.app.train.forward_model import load_model
from orbitfb.app.train.ground import Ground, find_ground
from orbitfb.app.train.request import Method, Progress, TrainingRequest, check
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.learn.builders import builder, first_policy
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.settings import PolicyKind
from orbitfb.policies.store.kinds import StoredPolicy
from orbitfb.policies.svd import SvdPolicy

_QUIET = 1.05
"""A law rests as quietly as another when its floor is below so many times that one's."""


@dataclass(frozen=True, slots=True)
class _Trained:
    """What came out, and what its card says about it."""

    policy: StoredPolicy
    training: dict[str, Any]
    curve: tuple[float, ...] = ()
    warning: str | None = None


def train_policy(
    config: AppConfig, request: TrainingRequest, progress: Progress = lambda *_: None
) -> dict[str, Any]:
    """Train a policy and store it with its card.

    An interrupted training lies in `training/` of the data directory and is taken up again by
    the same request.

    Args:
        config: Names ring and store; holds the settings of every method.
        request: What is asked for.
        progress: Told after every iteration.

    Returns:
        Id, method, figures, and `warning` where something is wrong with it.

    Raises:
        ConfigError: The request makes no sense.
        OrbitFeedbackError: Data or training failed; nothing was stored.
    """
    check(request)
    ground = find_ground(config, request)
    directory = config.data_directory / "training" / request.fingerprint
    if request.fresh:
        discard(directory)
    trained = _train(config, request, ground, directory, progress)
    store = open_store(config)
    identifier = store.save(
        trained.policy,
        ground.channels,
        parent=None if ground.start is None else ground.start.policy_id,
        data_hash=None if ground.transitions is None else data_hash(ground.transitions),
        figures=trained.training["figures"],
        training=trained.training,
    )
    discard(directory)
    answer: dict[str, Any] = {"stored": identifier, "method": request.method}
    answer |= trained.training["figures"]
    if trained.curve:
        answer["loss_first"], answer["loss_last"] = trained.curve[0], trained.curve[-1]
    warnings = [warning for warning in (trained.warning, store.card(identifier).warning) if warning]
    if warnings:
        answer["warning"] = "; ".join(warnings)
    if request.activate:
        answer |= activate_stored(config, identifier)
    return answer


def _train(
    config: AppConfig,
    request: TrainingRequest,
    ground: Ground,
    directory: Path,
    progress: Progress,
) -> _Trained:
    method = cast(Method, request.method)
    if method in ("svd", "modal", "network"):
        return _computed(method, _law(config, ground, method))
    if method == "structured":
        return _structured(config, request, ground, directory, progress)
    if method == "supervised":
        return _supervised(config, request, ground, directory, progress)
    return _trajectory(config, request, ground, directory, progress)


def _structured(
    config: AppConfig, request: TrainingRequest, ground: Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.policies.training.structured import train_structured

    settings = config.train.structured.model_copy(update=request.given())
    result = train_structured(
        ground.response,
        settings,
        start=cast(ModalPolicy, _law(config, ground, "modal")),
        draw=_draw(ground, config.train.samples),
        device=request.device,
        progress=lambda done, loss: say(done, settings.iterations, loss),
        checkpoint=directory,
        keep_better=True,
    )
    return _learnt(result, _no_better(result.figures, settings.iterations))


def _no_better(figures: Mapping[str, float], iterations: int) -> str | None:
    """Say what is wrong with a law that was trained from another one; None: nothing."""
    before, after = figures["held_out_before"], figures["held_out_after"]
    if not figures["improved"]:
        return (
            f"after {iterations} iterations the law was no better than the one that it began "
            f"with (loss on held-out trajectories {after:.4g} against {before:.4g}): the start is "
            "what is stored; give more iterations"
        )
    quiet, loud = figures["before_floor"], figures["after_floor"]
    if loud > _QUIET * quiet:
        return (
            f"the law recovers faster, but rests at {loud * 1e6:.3g} µm rms instead of "
            f"{quiet * 1e6:.3g} µm where nothing disturbs the orbit"
        )
    return None


def _supervised(
    config: AppConfig, request: TrainingRequest, ground: Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.policies.training.supervised import train_supervised
    from orbitfb.policies.training.supervised_settings import SupervisedSettings

    settings = config.train.supervised
    if request.published:
        settings = SupervisedSettings.paper(source=settings.source)
    settings = settings.model_copy(update=request.given())
    archive = None
    if settings.source == "archive":
        if ground.transitions is None:
            raise ConfigError("train.supervised.source is archive: name one with --from ARCHIVE")
        archive = _labels(ground.transitions)
    result = train_supervised(
        ground.response,
        settings,
        teacher=SvdPolicy(ground.response, config.policy.svd),
        archive=archive,
        device=request.device,
        progress=lambda done, loss: say(done, settings.iterations, loss),
        checkpoint=directory,
    )
    return _learnt(result)


def _trajectory(
    config: AppConfig, request: TrainingRequest, ground: Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.nets.device import pick_device
    from orbitfb.policies.training.trajectory import train_trajectory
    from orbitfb.policies.training.trajectory_settings import TrajectorySettings

    settings = TrajectorySettings.paper() if request.published else config.train.trajectory
    settings = settings.model_copy(update=request.given())
    start = None
    if request.warm:
        if not isinstance(ground.start, NetworkPolicy):
            raise ConfigError(f"--warm: policy {request.start} is no network; train one first")
        start = ground.start
    elif config.train.begin == "embedded" and not request.published:
        start = cast(NetworkPolicy, _law(config, ground, "network"))
    model = None
    if request.model is not None:
        model = load_model(config, request.model, ground.channels).torch_step(
            pick_device(request.device)
        )
    result = train_trajectory(
        ground.response,
        settings,
        start=start,
        model=model,
        draw=_draw(ground, config.train.samples) if model is None else None,
        device=request.device,
        progress=lambda done, loss: say(done, settings.iterations, loss),
        checkpoint=directory,
    )
    return _learnt(result)


def _law(config: AppConfig, ground: Ground, kind: PolicyKind) -> StoredPolicy:
    """Compute a law, of the posterior if there is one."""
    settings = config.policy.model_copy(update={"kind": kind})
    law = first_policy(ground.response, settings)
    if ground.posterior is not None:
        law = builder(settings)(ground.posterior, law)
    return cast(StoredPolicy, law)  # nothing is masked here


def _draw(ground: Ground, samples: int) -> Callable[[np.random.Generator], Vector] | None:
    """Let a training see what the data allow of R, when there are data."""
    model = ground.posterior
    if model is None or samples == 0:
        return None
    return lambda rng: np.array([model.sample(rng) for _ in range(samples)])


def _labels(transitions: Transitions) -> tuple[Vector, Vector]:
    """Give orbit errors and the changes that answered them, of ticks with the loop closed."""
    answered = transitions.closed & transitions.valid.all(axis=1)
    errors = (transitions.orbit - transitions.reference)[answered]
    return errors, (transitions.requested - transitions.dither)[answered]


def _computed(method: str, policy: StoredPolicy) -> _Trained:
    slope = np.eye(len(policy.response)) - policy.response @ policy.gain_matrix
    growth = float(np.max(np.abs(np.linalg.eigvals(slope))))
    training = {"method": method, "settings": {}, "seeds": {}, "figures": {"growth": growth}}
    return _Trained(policy, training)


def _learnt(result: Any, warning: str | None = None) -> _Trained:
    training = {
        "method": result.method,
        "settings": dict(result.settings),
        "seeds": dict(result.seeds),
        "figures": dict(result.figures),
        "curve": [float(loss) for loss in result.curve],
    }
    if warning is not None:
        training["warning"] = warning
    return _Trained(result.policy, training, tuple(result.curve), warning)


def discard(directory: Path) -> None:
    """Take the checkpoint of a training away."""
    if directory.exists():
        from orbitfb.nets.checkpoint import Checkpoint

        Checkpoint(directory).remove()
        directory.rmdir()

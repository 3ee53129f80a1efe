"""What `orbitfb train` does: bring response, data and settings together, train, store."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from orbitfb.config import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.history.archive import read_archive
from orbitfb.learn.builders import modal_law
from orbitfb.maintenance import activate_policy, data_hash, open_store
from orbitfb.models.identify import Identifier
from orbitfb.models.linear import LinearModel
from orbitfb.models.rows import select_rows
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.embedding import embed
from orbitfb.policies.kinds import StoredPolicy
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.svd import SvdPolicy

Method = Literal["svd", "modal", "structured", "network", "supervised", "trajectory"]
"""What can be trained; the first three and `network` are computed or nearly so."""

METHODS: tuple[Method, ...] = get_args(Method)

NOMINAL = "nominal"
"""The word for the response matrix of the optics."""

Progress = Callable[[int, int, float], None]
"""Told how many iterations are done, of how many, and the loss [1]."""


@dataclass(frozen=True, slots=True)
class TrainingRequest:
    """What is asked for.

    Args:
        method: How the policy is made.
        start: Response to begin from: `nominal`, or the id of a stored policy.
        archive: Operation to identify the response from, and for labels; None: none.
        published: Whether supervised or trajectory train as published, in place of the
            configured settings.
        warm: Whether the training begins with the network of the stored policy `start`.
        iterations: In place of the settings' number.
        seed: In place of the settings' seed.
        device: `auto`, `cpu` or `cuda`.
        fresh: Whether an interrupted training is thrown away, not resumed.
        activate: Whether the policy is put in force.
    """

    method: str
    start: str = NOMINAL
    archive: Path | None = None
    published: bool = False
    warm: bool = False
    iterations: int | None = None
    seed: int | None = None
    device: str = "auto"
    fresh: bool = False
    activate: bool = False


@dataclass(frozen=True, slots=True)
class _Ground:
    """What a training stands on."""

    response: Vector
    start: StoredPolicy | None
    posterior: LinearModel | None
    transitions: Transitions | None


@dataclass(frozen=True, slots=True)
class _Trained:
    """What came out, and what its card says about it."""

    policy: StoredPolicy
    training: dict[str, Any]
    curve: tuple[float, ...] = ()


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
        Id, method, figures, and where the curve of the loss is.

    Raises:
        ConfigError: The request makes no sense.
        OrbitFeedbackError: Data or training failed; nothing was stored.
    """
    if request.method not in METHODS:
        raise ConfigError(f"{request.method!r} cannot be trained; choose {', '.join(METHODS)}")
    _check(request)
    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)
    ground = _ground(config, request, ring)
    directory = config.data_directory / "training" / _fingerprint(config, request)
    if request.fresh:
        _discard(directory)
    trained = _train(config, request, ground, directory, progress)
    store = open_store(config)
    identifier = store.save(
        trained.policy,
        channels,
        parent=None if ground.start is None else ground.start.policy_id,
        data_hash=None if ground.transitions is None else data_hash(ground.transitions),
        figures=trained.training["figures"],
        training=trained.training,
    )
    _discard(directory)
    answer: dict[str, Any] = {"stored": identifier, "method": request.method}
    answer |= trained.training["figures"]
    if trained.curve:
        answer["loss_first"], answer["loss_last"] = trained.curve[0], trained.curve[-1]
    if request.activate:
        answer |= activate_policy(config, identifier)
    return answer


def _check(request: TrainingRequest) -> None:
    """Refuse options that the method has no use for, rather than ignore them."""
    descending = request.method in ("structured", "supervised", "trajectory")
    for name, given, useful in (
        ("--iterations", request.iterations is not None, descending),
        ("--published", request.published, request.method in ("supervised", "trajectory")),
        ("--warm", request.warm, request.method == "trajectory"),
    ):
        if given and not useful:
            raise ConfigError(f"{name} means nothing to the method {request.method}; leave it out")
    if request.iterations is not None and request.iterations < 1:
        raise ConfigError(f"--iterations {request.iterations}: give at least 1")
    if request.warm and request.start == NOMINAL:
        raise ConfigError("--warm begins with a stored network: name it with --start ID")


def _ground(config: AppConfig, request: TrainingRequest, ring: Ring) -> _Ground:
    channels = ring.channels(config.ring.planes)
    start: StoredPolicy | None = None
    if request.start == NOMINAL:
        matrix = response(ring, config.ring.planes)
    else:
        start = open_store(config).load(request.start, channels)
        matrix = start.response
    if request.archive is None:
        return _Ground(matrix, start, None, None)
    transitions = read_archive(request.archive, channels)
    identifier = Identifier(matrix, config.learn.identify)
    identifier.absorb(select_rows(transitions, config.learn.tolerance))
    posterior = identifier.model
    if identifier.last_tick is None and request.method != "supervised":
        raise ConfigError(
            f"no transition of {request.archive} can be used to identify the response; record "
            "with the loop CLOSED and readbacks that follow the setpoints"
        )
    return _Ground(posterior.response, start, posterior, transitions)


def _train(
    config: AppConfig,
    request: TrainingRequest,
    ground: _Ground,
    directory: Path,
    progress: Progress,
) -> _Trained:
    method = cast(Method, request.method)
    if method == "svd":
        covariance = _covariance(config, ground)
        return _computed(method, SvdPolicy(ground.response, config.policy.svd, None, covariance))
    if method == "modal":
        return _computed(method, _modal(config, ground))
    if method == "network":
        return _computed(method, embed(_modal(config, ground), config.policy.network))
    if method == "structured":
        return _structured(config, request, ground, directory, progress)
    if method == "supervised":
        return _supervised(config, request, ground, directory, progress)
    return _trajectory(config, request, ground, directory, progress)


def _structured(
    config: AppConfig, request: TrainingRequest, ground: _Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.policies.structured import train_structured

    settings = _adapted(config.train.structured, request)
    result = train_structured(
        ground.response,
        settings,
        start=_modal(config, ground),
        draw=_draw(ground, config.train.samples),
        device=request.device,
        progress=lambda done, loss: say(done, settings.iterations, loss),
        checkpoint=directory,
    )
    return _learnt(result)


def _supervised(
    config: AppConfig, request: TrainingRequest, ground: _Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.policies.supervised import train_supervised
    from orbitfb.policies.supervised_settings import SupervisedSettings

    settings = config.train.supervised
    if request.published:
        settings = SupervisedSettings.paper(source=settings.source)
    settings = _adapted(settings, request)
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
    config: AppConfig, request: TrainingRequest, ground: _Ground, directory: Path, say: Progress
) -> _Trained:
    from orbitfb.policies.trajectory import train_trajectory
    from orbitfb.policies.trajectory_settings import TrajectorySettings

    settings = TrajectorySettings.paper() if request.published else config.train.trajectory
    settings = _adapted(settings, request)
    if request.warm and not isinstance(ground.start, NetworkPolicy):
        raise ConfigError(f"--warm: policy {request.start} is no network; train one first")
    result = train_trajectory(
        ground.response,
        settings,
        start=ground.start if request.warm else None,  # type: ignore[arg-type]
        draw=_draw(ground, config.train.samples),
        device=request.device,
        progress=lambda done, loss: say(done, settings.iterations, loss),
        checkpoint=directory,
    )
    return _learnt(result)


def _modal(config: AppConfig, ground: _Ground) -> ModalPolicy:
    law = ModalPolicy(ground.response, config.policy.modal)
    return law if ground.posterior is None else modal_law(ground.posterior, law, config.policy)


def _covariance(config: AppConfig, ground: _Ground) -> Vector | None:
    if ground.posterior is None or not config.policy.cautious:
        return None
    return ground.posterior.row_covariance


def _draw(ground: _Ground, samples: int) -> Callable[[np.random.Generator], Vector] | None:
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


def _adapted(settings: Any, request: TrainingRequest) -> Any:
    given = {"iterations": request.iterations, "seed": request.seed}
    return settings.model_copy(update={k: v for k, v in given.items() if v is not None})


def _computed(method: str, policy: StoredPolicy) -> _Trained:
    slope = np.eye(len(policy.response)) - policy.response @ policy.gain_matrix
    growth = float(np.max(np.abs(np.linalg.eigvals(slope))))
    training = {"method": method, "settings": {}, "seeds": {}, "figures": {"growth": growth}}
    return _Trained(policy, training)


def _learnt(result: Any) -> _Trained:
    training = {
        "method": result.method,
        "settings": dict(result.settings),
        "seeds": dict(result.seeds),
        "figures": dict(result.figures),
        "curve": [float(loss) for loss in result.curve],
    }
    return _Trained(result.policy, training, tuple(result.curve))


def _fingerprint(config: AppConfig, request: TrainingRequest) -> str:
    """Name the directory of a training, so that the same request finds it again."""
    named = [request.method, request.start, str(request.archive), request.published, request.warm]
    named += [request.seed, config.ring.planes]
    digest = hashlib.sha256(json.dumps(named).encode()).hexdigest()[:12]
    return f"{request.method}-{digest}"


def _discard(directory: Path) -> None:
    if directory.exists():
        from orbitfb.nets.checkpoint import Checkpoint

        Checkpoint(directory).remove()
        directory.rmdir()

"""Supervised training: a network learns changes that are known for many orbit errors.

    minimise  Σ | T⁻¹ (π(e) − a) |²   over the matrices of the network π, by Adam

Labels a come from an archive of operation, from a teacher asked on random states, or from
random changes run forward (`policies.training.labels`). The coordinates T of the changes decide
what is learnt (settings `coordinates`):

- raw, T = change_scale · I: the paper's form. The error is the same for all correctors, so of a
  law whose gains K U spread over decades the small ones are learnt last: a short training is a
  clone with wrong slow modes;
- modes, T = V Σ⁻¹ s: the error of the orbit, |R (π(e) − a)|². The network sees a well-conditioned
  task, but a mode that the law corrects by 10⁻⁴ per tick counts 10⁻⁴ of one that it corrects at
  once, and an error of that size turns its sign;
- teacher, T = K U s: every mode relative to what the law does there. The slope of a network that
  is trained in this form is K (I + E) with E the error; with U the modes of R and K made of R the
  closed loop is stable if |E| < 1, however slow a mode is.

The network is trained in these coordinates (input Uᵀ e / s but for raw); the fixed matrices are
multiplied into its first and last one at the end, so that the policy is the paper's plain
network.

Source: the supervised baseline of the paper; the coordinates are ours.
"""

from pathlib import Path

import numpy as np
import torch

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.nets.device import pick_device
from orbitfb.nets.perceptron import Perceptron
from orbitfb.nets.training import Progress, train
from orbitfb.policies.inverse import checked_response, content_hash
from orbitfb.policies.network import NetworkPolicy, NetworkSettings, network_sizes
from orbitfb.policies.training.coordinates import Coordinates
from orbitfb.policies.training.labels import Law, Lesson, from_actions, from_archive, from_states
from orbitfb.policies.training.result import TrainingResult
from orbitfb.policies.training.rollout import learning_rate
from orbitfb.policies.training.supervised_settings import SupervisedSettings

_CHECKED = 512
_LOST = 1e-10
"""Gain of a mode, relative to the largest, below which a law does not act on it [1]."""


def train_supervised(
    response: Vector,
    settings: SupervisedSettings,
    *,
    teacher: Law | None = None,
    archive: tuple[Vector, Vector] | None = None,
    device: str = "auto",
    progress: Progress | None = None,
    checkpoint: Path | None = None,
) -> TrainingResult:
    """Train a network of the paper's shape on labels.

    Args:
        response: R, shape (n, m) [m/A].
        settings: Where labels come from and how they are learnt.
        teacher: The law that is asked, for the source `states`.
        archive: Orbit errors (T, n) [m] and changes (T, m) [A] of T ticks, for the source
            `archive`; rows that are not finite are left out.
        device: `auto`, `cpu` or `cuda`.
        progress: Told after every iteration.
        checkpoint: Directory in which an interrupted training is kept and from which it goes on.

    Returns:
        The policy, the loss at every iteration, and the figures `label_error` (rms of π(e) − a
        over that of a, on samples that were not trained on), `orbit_error` (the same for what
        both do to the orbit), `gain_error` (largest singular value of E above), `growth` and
        `label_growth` (largest growth of the orbit per tick at zero, of the policy and of the
        law behind the labels).

    Raises:
        ConfigError: Teacher or archive is missing, or the device.
        EstimationError: The archive holds too little.
        TrainingError: The loss is no longer a number.
    """
    response = checked_response(response)
    lesson = _lesson(response, settings, teacher, archive)
    coordinates = _coordinates(response, lesson.gain, settings)
    network = Perceptron(network_sizes(*response.shape), settings.seed, settings.output_scale)
    place = pick_device(device)
    network.to(place)
    generator = torch.Generator().manual_seed(settings.seed + 1)
    inward, labels = coordinates.inward.T, coordinates.outward_inverse.T

    def loss_at(_iteration: int) -> torch.Tensor:
        errors, changes = lesson.training(settings.batch, generator)
        wanted = _single(changes @ labels, place)
        square = torch.mean((network(_single(errors @ inward, place)) - wanted) ** 2, dim=1)
        if settings.relative:
            square = square / torch.mean(wanted**2, dim=1)
        return torch.mean(square)

    purpose = {
        "method": "supervised",
        "settings": settings.model_dump(mode="json"),
        "data": content_hash(settings, response, lesson.gain),
    }
    curve = train(
        {"network": network},
        loss_at,
        iterations=settings.iterations,
        learning_rate=learning_rate(
            settings.learning_rate, settings.final_learning_rate, settings.iterations
        ),
        generator=generator,
        clip=settings.clip,
        progress=progress,
        checkpoint=None if checkpoint is None else Checkpoint(checkpoint, purpose),
    )
    input_settings = NetworkSettings()
    weights = coordinates.outer(network.arrays(), input_settings.input_scale)
    policy = NetworkPolicy(weights, response, input_settings)
    return TrainingResult(
        policy=policy,
        method="supervised",
        settings=settings.model_dump(mode="json"),
        seeds={"weights": settings.seed, "draws": settings.seed + 1},
        curve=tuple(curve),
        figures=_figures(policy, lesson, settings),
    )


def _lesson(
    response: Vector,
    settings: SupervisedSettings,
    teacher: Law | None,
    archive: tuple[Vector, Vector] | None,
) -> Lesson:
    if settings.source == "actions":
        return from_actions(response, settings)
    if settings.source == "states":
        if teacher is None:
            raise ConfigError("the source 'states' asks a teacher: name one, such as an SVD policy")
        return from_states(response, teacher, settings)
    if archive is None:
        raise ConfigError("the source 'archive' needs one: name a directory of recorded operation")
    return from_archive(*archive, settings)


def _coordinates(response: Vector, gain: Vector, settings: SupervisedSettings) -> Coordinates:
    scale = settings.orbit_scale
    if settings.coordinates == "raw":
        return Coordinates.raw(response, scale, settings.change_scale)
    if settings.coordinates == "modes":
        return Coordinates.modes(response, scale)
    n, m = response.shape
    modes = np.linalg.svd(response, full_matrices=True)[0]
    outward = np.zeros((m, m))
    common = min(n, m)
    outward[:, :common] = scale * (gain @ modes[:, :common])
    back = np.asarray(np.linalg.pinv(outward, rcond=_LOST), dtype=np.float64)
    return Coordinates(modes.T / scale, outward, modes * scale, back)


def _figures(
    policy: NetworkPolicy, lesson: Lesson, settings: SupervisedSettings
) -> dict[str, float]:
    generator = torch.Generator().manual_seed(settings.seed + 2)
    errors, changes = lesson.checking(_CHECKED, generator)
    missed, response = policy.changes(errors) - changes, policy.response
    inverse = np.linalg.pinv(lesson.gain, rcond=_LOST)
    return {
        "label_error": _ratio(missed, changes),
        "orbit_error": _ratio(missed @ response.T, changes @ response.T),
        "gain_error": float(np.linalg.norm(inverse @ (policy.gain_matrix - lesson.gain), 2)),
        "growth": _growth(response, policy.gain_matrix),
        "label_growth": _growth(response, lesson.gain),
    }


def _growth(response: Vector, gain: Vector) -> float:
    return float(np.max(np.abs(np.linalg.eigvals(np.eye(len(response)) - response @ gain))))


def _ratio(part: Vector, whole: Vector) -> float:
    return float(np.linalg.norm(part) / np.linalg.norm(whole))


def _single(values: Vector, device: torch.device) -> torch.Tensor:
    return torch.from_numpy(values.astype(np.float32)).to(device)

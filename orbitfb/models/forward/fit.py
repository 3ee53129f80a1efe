"""Fit the forward net f(s, a) → s' − s to transitions, and validate it honestly.

The nets are fitted to innovations, not to one-step errors (`orbitfb.models.innovations`): in
closed loop the plain regression learns the loop's own law. Whether that has worked is judged on
rows with another excitation only (`orbitfb.models.forward.validation`).
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.models.forward.net import Coordinates, ForwardNet
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.models.forward.validation import orbit_of, other_changes, validate
from orbitfb.models.innovations import Noise, estimate_noise, innovations, windows
from orbitfb.models.rows import Rows
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.nets.device import pick_device
from orbitfb.nets.perceptron import Perceptron
from orbitfb.nets.training import Progress, train

_CLIP = 10.0
_LEAST_EXCITED = 1e-3


def fit_forward(
    rows_train: Rows,
    rows_validation: Rows,
    response: Vector,
    settings: ForwardSettings,
    device: str | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    every: int = 100,
) -> ForwardNet:
    """Fit an ensemble and validate it.

    Args:
        rows_train: What to learn from, of `select_rows`.
        rows_validation: Rows with another excitation: dithered, explored or by another policy.
        response: R̂, shape (n, m) [m/A]: gives the coordinates and, in the residual form, what the
            nets add to.
        settings: Nets, training, validation.
        device: Overrides the settings' one.
        progress: Told after every iteration.
        checkpoint: Where to keep the training, and to resume it.
        every: Iterations between two checkpoints.

    Returns:
        The ensemble; its `figures` are those of `forward_validation.validate`, and those with
        `trusted` 0 must not be acted on.

    Raises:
        EstimationError: The rows are too few, nothing was excited, or the validation rows have no
            other excitation than the training rows.
        TrainingError: The training diverged.
        StoreError: The checkpoint is damaged or of another training.
    """
    if not np.any(rows_train.change):
        raise EstimationError("nothing was written in the training rows; close the loop or explore")
    other_changes(rows_train, rows_validation, settings, response)
    net, noise = train_forward(rows_train, response, settings, device, progress, checkpoint, every)
    figures = validate(net, rows_train, rows_validation, noise, settings)
    return replace(net, figures=figures)


def train_forward(
    rows: Rows,
    response: Vector,
    settings: ForwardSettings,
    device: str | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    every: int = 100,
) -> tuple[ForwardNet, Noise]:
    """Fit an ensemble without validating it: for who judges it on a record of his own.

    Args:
        rows: What to learn from.
        response: As for `fit_forward`.
        settings: Nets and training.
        device: As for `fit_forward`.
        progress: As for `fit_forward`.
        checkpoint: As for `fit_forward`.
        every: As for `fit_forward`.

    Returns:
        The ensemble, without figures, and the noise of the modes.

    Raises:
        EstimationError: The rows are too few, or nothing was excited.
        TrainingError: The training diverged.
        StoreError: The checkpoint is damaged or of another training.
    """
    if not np.any(rows.change):
        raise EstimationError("nothing was written in the training rows; close the loop or explore")
    base = response if settings.residual else np.zeros_like(response)
    modes, _, directions = np.linalg.svd(response)
    errors = rows.difference - rows.change @ response.T
    errors = np.where(rows.valid, errors, 0.0)
    noise = estimate_noise(errors, rows.starts, modes, settings.reading_noise, settings.ground)
    at = _coordinates(rows, noise, modes, directions.T, settings)
    members = [
        Perceptron((sum(response.shape), *settings.hidden, len(modes)), 1000 * settings.seed + k)
        for k in range(settings.members)
    ]
    generator = torch.Generator().manual_seed(settings.seed)
    if settings.residual:
        for member in members:
            *hidden, last = member.arrays()
            member.load_arrays([*hidden, np.zeros_like(last)])
    target = pick_device(device or settings.device)
    curve = train(
        {f"member{k}": member.to(target) for k, member in enumerate(members)},
        _loss(rows, base, at, noise, members, settings, target, generator),
        iterations=settings.iterations,
        learning_rate=_cosine(settings),
        generator=generator,
        clip=_CLIP,
        progress=progress,
        checkpoint=checkpoint,
        checkpoint_every=every,
    )
    net = ForwardNet(base, at, tuple(member.arrays() for member in members), {}, tuple(curve))
    return net, noise


def _coordinates(
    rows: Rows, noise: Noise, modes: Vector, directions: Vector, settings: ForwardSettings
) -> Coordinates:
    """Scale every direction by what the rows made of it; one that was hardly moved, by a floor."""

    def size(columns: Vector) -> Vector:
        rms = np.sqrt(np.mean(columns**2, axis=0))
        return np.maximum(rms, max(_LEAST_EXCITED * rms.max(), np.finfo(float).tiny))

    answer = np.sqrt(noise.variances)
    if not settings.residual:
        answer = np.maximum(answer, size(rows.difference @ modes))
    orbit = np.maximum(size(orbit_of(rows) @ modes), np.sqrt(noise.variances))
    return Coordinates(modes, directions, orbit, size(rows.change @ directions), answer)


def _cosine(settings: ForwardSettings) -> Callable[[int], float]:
    def rate(iteration: int) -> float:
        phase = math.pi * iteration / settings.iterations
        return settings.learning_rate * 0.5 * (1.0 + math.cos(phase))

    return rate


def _loss(
    rows: Rows,
    base: Vector,
    at: Coordinates,
    noise: Noise,
    members: list[Perceptron],
    settings: ForwardSettings,
    target: torch.device,
    generator: torch.Generator,
) -> Callable[[int], torch.Tensor]:
    """Mean squared innovation of every member on windows drawn from its own sample."""

    def tensor(array: Vector) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(array), dtype=torch.float32, device=target)

    index = windows(rows, settings.window)
    unexplained = np.where(rows.valid, rows.difference - rows.change @ base.T, 0.0)
    wanted = tensor(innovations(unexplained, index, noise, at.modes))
    inputs = tensor(at.inputs(orbit_of(rows), rows.change)[index])
    filters = tensor(noise.filters(settings.window) * at.answer[:, None, None])
    size = tensor(at.answer / np.sqrt(noise.variances))
    draws = np.random.default_rng(settings.seed)
    samples = [
        torch.from_numpy(draws.integers(len(index), size=len(index)))
        if settings.bootstrap and len(members) > 1
        else torch.arange(len(index))
        for _ in members
    ]
    belief = settings.belief / len(rows)
    count = min(len(index), max(1, settings.batch // settings.window))

    def loss_at(_: int) -> torch.Tensor:
        total = torch.zeros((), device=target)
        for member, sample in zip(members, samples, strict=True):
            chosen = sample[torch.randint(len(sample), (count,), generator=generator)].to(target)
            answer = member(inputs[chosen])
            filtered = torch.einsum("nij,bjn->bin", filters, answer)
            total = total + torch.mean((wanted[chosen] - filtered) ** 2)
            total = total + belief * torch.mean((answer * size) ** 2)
        return total / len(members)

    return loss_at

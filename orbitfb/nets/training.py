"""One training loop for every network: Adam, clipping, progress, interruption, resumption.

The loss of an iteration may depend on the iteration's number, on the modules and on draws from
the generator handed in, and on nothing else: then a training that was interrupted and resumed
gives the same weights, bit for bit on a CPU, as one that was not.
"""

import math
import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

import torch

from orbitfb.core.errors import TrainingError
from orbitfb.nets.checkpoint import Checkpoint, Modules

Progress = Callable[[int, float], None]
"""Told after every iteration how many are done, and the loss [1]."""


def train(
    modules: Modules,
    loss_at: Callable[[int], torch.Tensor],
    *,
    iterations: int,
    learning_rate: float | Callable[[int], float],
    generator: torch.Generator,
    clip: float | None = None,
    progress: Progress | None = None,
    checkpoint: Checkpoint | None = None,
    checkpoint_every: int = 100,
) -> list[float]:
    """Minimise a loss over the parameters that ask for a gradient.

    If there is a checkpoint it is resumed, and a new one is kept every so often, at the end, and
    when the training is interrupted from the keyboard (once more: at once, unsaved).

    Args:
        modules: What is trained, by name. A parameter is left alone with `requires_grad_(False)`.
        loss_at: Loss of an iteration, counted from 0; a scalar tensor.
        iterations: How many in all, those before an interruption included.
        learning_rate: Of Adam [1], or what it is at an iteration.
        generator: What `loss_at` draws from. One on the CPU gives the same draws for all devices.
        clip: Largest norm of the gradient [1]; None: not limited.
        progress: Told after every iteration.
        checkpoint: Where to keep and resume.
        checkpoint_every: Iterations between two checkpoints.

    Returns:
        The loss at every iteration, those before an interruption included.

    Raises:
        TrainingError: Loss or gradient are no longer finite; the weights are those before.
        StoreError: The checkpoint is damaged or of another training.
    """
    parameters = [p for module in modules.values() for p in module.parameters() if p.requires_grad]
    optimiser = torch.optim.Adam(parameters, lr=1e-3, fused=True)
    first, curve = 0, list[float]()
    if checkpoint is not None and checkpoint.exists():
        first, curve = checkpoint.load(modules, optimiser, generator)
    saved = first
    with _interruptible(checkpoint is not None) as interruption:
        for iteration in range(first, iterations):
            rate = learning_rate(iteration) if callable(learning_rate) else learning_rate
            for group in optimiser.param_groups:
                group["lr"] = rate
            optimiser.zero_grad(set_to_none=True)
            loss = loss_at(iteration)
            value = float(loss.detach())
            if math.isfinite(value):
                loss.backward()
            _limit_gradient(parameters, value, clip, iteration, rate, curve)
            optimiser.step()
            curve.append(value)
            done = iteration + 1
            if progress is not None:
                progress(done, value)
            if checkpoint is not None and (
                interruption.asked or done == iterations or done - saved >= checkpoint_every
            ):
                checkpoint.save(done, modules, optimiser, generator, curve)
                saved = done
            if interruption.asked:
                raise KeyboardInterrupt
    return curve


def _limit_gradient(
    parameters: list[torch.nn.Parameter],
    loss: float,
    clip: float | None,
    iteration: int,
    rate: float,
    curve: list[float],
) -> None:
    norm, what = math.nan, "loss"
    if math.isfinite(loss):
        gradients = [p.grad for p in parameters if p.grad is not None]
        total = torch.nn.utils.get_total_norm(gradients)
        norm, what = float(total), "gradient"
        if clip is not None and norm > clip and math.isfinite(norm):
            torch.nn.utils.clip_grads_with_norm_(parameters, clip, total)
    if not math.isfinite(norm):
        before = f"{curve[-1]:.3g}" if curve else "none"
        limit = "no limit" if clip is None else f"a limit of {clip:g}"
        raise TrainingError(
            f"the {what} is not finite at iteration {iteration} (the loss before was {before}); "
            f"lower the learning rate ({rate:g}), limit the gradient (there is {limit}), or begin "
            "with smaller amplitudes or a shorter horizon"
        )


@dataclass(slots=True)
class _Interruption:
    asked: bool = False


@contextmanager
def _interruptible(saving: bool) -> Generator[_Interruption, None, None]:
    """Let a Ctrl-C wait until the iteration is complete, so that what is saved is consistent."""
    interruption = _Interruption()
    if not saving or threading.current_thread() is not threading.main_thread():
        yield interruption
        return
    before = signal.getsignal(signal.SIGINT)

    def ask(_number: int, _frame: FrameType | None) -> None:
        if interruption.asked:
            raise KeyboardInterrupt
        interruption.asked = True

    signal.signal(signal.SIGINT, ask)
    try:
        yield interruption
    finally:
        signal.signal(signal.SIGINT, before)

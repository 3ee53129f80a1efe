"""Improve a running network from its own weights, without being able to make it worse.

At a swap of the response model the incumbent is trained on for a few iterations, on samples of
what is now believed about the response (R̂ plus draws of its covariance). Short training with
noise does not always help, so incumbent and candidate then run in closed loop on the same
samples with the same orbits and noise, and the candidate is taken only if it is better over
all and no worse at the noise floor. These samples are others than those trained on, if there
are enough.
"""

import time

import numpy as np

from orbitfb.core.errors import RingError, TrainingError
from orbitfb.core.signals import Vector
from orbitfb.nets.device import pick_device
from orbitfb.policies.inverse import checked_response
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.training.rehearsal import Rehearsal, Verdict, judge, spectral_radius
from orbitfb.policies.training.result import TrainingResult
from orbitfb.policies.training.rollout import LinearResponses, Model
from orbitfb.policies.training.trajectory import build, descend
from orbitfb.policies.training.trajectory_settings import FineTuneSettings


def fine_tune(
    incumbent: NetworkPolicy,
    samples: Vector,
    settings: FineTuneSettings | None = None,
    *,
    response: Vector | None = None,
    device: str = "cpu",
) -> TrainingResult[NetworkPolicy]:
    """Train a network on, on samples of the response, and keep the better of before and after.

    Args:
        incumbent: The running network, or a law embedded anew.
        samples: Response matrices as they may be now, shape (S, n, m) [m/A].
        settings: How; the defaults are for a swap of the running loop.
        response: R̂ for the coordinates and for the policy to carry, shape (n, m) [m/A]; None:
            the mean of the samples.
        device: `auto`, `cpu` or `cuda`.

    Returns:
        The policy that is kept, and figures: `improved` (1: trained, 0: the incumbent itself),
        `before_…` and `after_…` score [1], floor [m], worst [m], `spectral_radius` [1],
        `seconds`. The curve is empty if training ran into something that is not finite.

    Raises:
        RingError: Samples or incumbent do not fit together.
        ConfigError: What is trained does not fit the incumbent.
    """
    settings = settings or FineTuneSettings()
    began = time.perf_counter()
    samples = _checked_samples(samples, incumbent)
    held_out = settings.judged_samples if len(samples) > settings.judged_samples else 0
    seen, judged = samples[: len(samples) - held_out], samples[-held_out:]
    centre = checked_response(np.mean(samples, axis=0) if response is None else response)
    target = pick_device(device)
    network = build(centre, settings, incumbent).to(target)
    groups = [
        LinearResponses(seen[first : first + settings.samples_per_iteration], target)
        for first in range(0, len(seen), settings.samples_per_iteration)
    ]

    def model_at(iteration: int) -> tuple[Model, int]:
        group = groups[iteration % len(groups)]
        return group, group.count

    trial = Rehearsal(
        amplitude=settings.amplitude,
        reading_noise=settings.reading_noise,
        orbit_noise=settings.orbit_noise,
        steps=settings.judged_steps,
        seed=settings.seed,
    )
    before = judge(incumbent, judged, trial)
    kept, after, curve = incumbent, Verdict(np.inf, np.inf, np.inf), list[float]()
    try:
        curve = descend(network, model_at, centre, settings, target)
        candidate = network.export(centre)
    except (TrainingError, RingError):
        # Diverged: the incumbent stays, and the figures say so.
        candidate = None
    if candidate is not None:
        after = judge(candidate, judged, trial)
        if after.better_than(before, settings.floor_tolerance):
            kept = candidate
    improved = kept is not incumbent
    figures = {
        "improved": float(improved),
        **{f"before_{name}": getattr(before, name) for name in ("score", "floor", "worst")},
        **{f"after_{name}": getattr(after, name) for name in ("score", "floor", "worst")},
        "spectral_radius": spectral_radius(kept.gain_matrix, centre),
        "seconds": time.perf_counter() - began,
    }
    return TrainingResult(
        policy=kept,
        method="fine-tune",
        settings=settings.model_dump(mode="json"),
        seeds={"seed": settings.seed},
        curve=tuple(curve),
        figures=figures,
    )


def _checked_samples(samples: Vector, incumbent: NetworkPolicy) -> Vector:
    matrices = np.asarray(samples, dtype=np.float64)
    if matrices.ndim != 3 or 0 in matrices.shape or not np.isfinite(matrices).all():
        raise RingError(
            f"samples of the response have shape {matrices.shape}; finite numbers of shape "
            "(samples, n, m) [m/A] are needed"
        )
    if matrices.shape[1:] != incumbent.response.shape:
        raise RingError(
            f"the samples are for {matrices.shape[1:]} (BPMs, correctors), the network is for "
            f"{incumbent.response.shape}"
        )
    return matrices

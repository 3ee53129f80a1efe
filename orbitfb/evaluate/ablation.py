"""What every option of training through the model is worth, one changed at a time.

Two forms are taken apart. From the *full* form (modes, relative loss, amplitudes over decades,
random start) every option is set back to what the paper has; from the *plain* form (Algorithm 1
as published) every option is switched on alone. Beside them stand the embedded law with each
choice of what is trained, and the structured law. Every variant is judged in closed loop with
reading noise, on the ring it was trained on or on rings that differ from it by a stated spread.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.signals import Vector
from orbitfb.policies.embedding import embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import NetworkPolicy
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.policies.training.rehearsal import Memoryless, Rehearsal, rehearse, spectral_radius
from orbitfb.policies.training.structured import train_structured
from orbitfb.policies.training.trajectory import train_trajectory
from orbitfb.policies.training.trajectory_settings import StructuredSettings, TrajectorySettings

_NEAR = 0.05e-3
_LATE = 50
_FAR = 1e-2
_RINGS = 0x61


@dataclass(frozen=True, slots=True)
class Variant:
    """One row of the table.

    Args:
        name: What is different, in words.
        group: Which rows it is to be compared with.
        form: `network`, `structured`, or a law that is not trained: `svd`, `cautious svd`,
            `modal`, `cautious modal`, `embedded`.
        change: Keys of the settings that are different.
        start: What it begins with: `random`, `embedded`, or `uninformed` (structured).
        ensemble: Whether it is trained on drawn responses.
    """

    name: str
    group: str
    form: str = "network"
    change: dict[str, Any] = field(default_factory=dict)
    start: str = "random"
    ensemble: bool = False


def variants(iterations: int, plain_iterations: Sequence[int]) -> Iterator[Variant]:
    """Give the rows of the table.

    Args:
        iterations: Steps of Adam of the full form.
        plain_iterations: Steps of Adam of the plain form, a row for each; its options are
            switched on at the first.
    """
    paper = TrajectorySettings.paper()

    def published(*keys: str) -> dict[str, Any]:
        return {"iterations": iterations, **{key: getattr(paper, key) for key in keys}}

    for form in ("svd", "cautious svd", "modal", "cautious modal", "embedded"):
        yield Variant(form, "untrained", form)
    yield Variant("full", "full", change=published())
    for name, keys in (
        ("raw coordinates", ("coordinates", "first_output")),
        ("cost the plain rms", ("loss",)),
        ("all orbits at 250 µm", ("smallest_amplitude",)),
        ("both of these", ("loss", "smallest_amplitude")),
        ("learning rate 1e-4", ("learning_rate", "final_learning_rate")),
        ("first output 0.05", ("first_output",)),
        ("no limit of the gradient", ("clip",)),
        ("discount 0.99", ("discount",)),
        ("horizon 10", ("horizon",)),
    ):
        yield Variant(f"full, {name}", "full", change=published(*keys))
    for name, change in (
        ("cost the logarithm", {"loss": "log"}),
        ("horizon 1", {"horizon": 1}),
        ("horizon grows", {"horizon_curriculum": 0.5}),
        ("amplitudes widen", {"amplitude_curriculum": 0.5}),
        ("learning rate constant", {"final_learning_rate": None}),
        ("input scale 0.25 mm", {"orbit_scale": 0.25e-3}),
        ("input scale 10 mm", {"orbit_scale": 10e-3}),
        ("reading noise", {"reading_noise": 0.2e-6}),
    ):
        yield Variant(f"full, {name}", "full", change={"iterations": iterations, **change})
    yield Variant("full, drawn responses", "full", change=published(), ensemble=True)
    for count in plain_iterations:
        plain = paper.model_copy(update={"iterations": count}).model_dump()
        yield Variant(f"plain, {count} iterations", "plain", change=plain)
    first = {**paper.model_dump(), "iterations": plain_iterations[0]}
    for name, change in (
        ("coordinates of the modes", {"coordinates": "modes", "first_output": 1.0}),
        ("relative loss", {"loss": "relative"}),
        ("amplitudes over decades", {"smallest_amplitude": 0.25e-6}),
        ("both of these", {"loss": "relative", "smallest_amplitude": 0.25e-6}),
        ("learning rate 1e-3", {"learning_rate": 1e-3}),
        ("gradient limited", {"clip": 1.0}),
    ):
        yield Variant(f"plain, {name}", "plain", change={**first, **change})
    noisy = {"reading_noise": 0.2e-6, "iterations": iterations, "learning_rate": 3e-4}
    for trained in ("all", "last", "output", "spare"):
        change = {**noisy, "trained": trained, "final_learning_rate": 3e-5}
        yield Variant(f"embedded, {trained} trained", "embedded", "network", change, "embedded")
    yield Variant("structured", "structured", "structured", start="uninformed")
    for trained in ("far", "floor", "threshold"):
        change = {"trained": (trained,)}
        name = f"structured, {trained} alone"
        yield Variant(name, "structured", "structured", change, "uninformed")
    informed = ("modal", False), ("modal", True), ("uninformed", True)
    for start, ensemble in informed:
        name = f"structured, from {start}" + (", drawn responses" if ensemble else "")
        yield Variant(name, "structured", "structured", {}, start, ensemble)


def ablate(
    response: Vector,
    rows: Sequence[Variant],
    *,
    seeds: Sequence[int] = (0, 1, 2),
    spread: float = 1e-6,
    trajectories: int = 8,
    steps: int = 300,
    reading_noise: float = 0.2e-6,
    told: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Train and judge every variant with every seed.

    Args:
        response: R that the training knows, shape (n, m) [m/A].
        rows: What to compare.
        seeds: Seeds of weights, draws and orbits.
        spread: Rms by which every entry of the other rings differs from R, and of the drawn
            responses in training [m/A].
        trajectories: Trajectories per seed in the judging.
        steps: Their length; the last 50 steps are the floor.
        reading_noise: Noise of the readings in the judging, rms [m].
        told: Told the name of every variant before it is run.

    Returns:
        Circumstances, and under `rows` per variant what it is and its figures, medians over the
        seeds with the worst seed beside: on the ring `known` and on `others`: `floor` (true
        orbit, rms) [m], `worst` [m], `steps` to 0.05 mm [1] (null: never), `diverged` (share of
        trajectories above 10 mm or not finite) [1]; `spectral_radius` [1], `processor_seconds`.
        A training that failed has `failed`, with the reason.
    """
    table = []
    for row in rows:
        if told is not None:
            told(row.name)
        runs = list[dict[str, Any]]()
        entry: dict[str, Any] = {"name": row.name, "group": row.group, "change": row.change}
        for seed in seeds:
            began = time.process_time()
            try:
                policy = _made(row, response, seed, spread)
            except OrbitFeedbackError as error:
                entry["failed"] = str(error)
                break
            spent = time.process_time() - began
            trial = Rehearsal(reading_noise=reading_noise, steps=steps, seed=seed)
            rng = np.random.default_rng([seed, _RINGS])
            known = np.broadcast_to(response, (trajectories, *response.shape))
            others = known + spread * rng.standard_normal(known.shape)
            runs.append(
                {
                    "processor_seconds": spent,
                    "spectral_radius": spectral_radius(policy.gain_matrix, response),
                    "known": _figures(rehearse(policy, known, trial)),
                    "others": _figures(rehearse(policy, others, trial)),
                }
            )
        table.append({**entry, **_over_seeds(runs)})
    return {
        "bpms": response.shape[0],
        "correctors": response.shape[1],
        "seeds": list(seeds),
        "spread": spread,
        "trajectories": trajectories,
        "steps": steps,
        "reading_noise": reading_noise,
        "rows": table,
    }


def _made(row: Variant, response: Vector, seed: int, spread: float) -> Any:
    """Make the policy of a row: a `Memoryless` with its `gain_matrix`."""

    def draw(rng: np.random.Generator) -> Vector:
        return response + spread * rng.standard_normal((8, *response.shape))

    covariance = spread**2 * np.eye(response.shape[1])
    modal = ModalPolicy(response, ModalSettings())
    drawing = draw if row.ensemble else None
    match row.form:
        case "svd":
            return _Linear(SvdPolicy(response, SvdSettings()).gain_matrix)
        case "cautious svd":
            settings = SvdSettings(gain=1.0, regularisation=0.0)
            return _Linear(SvdPolicy(response, settings, covariance=covariance).gain_matrix)
        case "modal":
            return modal
        case "cautious modal":
            return ModalPolicy(response, ModalSettings(), covariance=covariance)
        case "embedded":
            return embed(modal)
        case "structured":
            settings = StructuredSettings(seed=seed, **row.change)
            law = modal
            if row.start == "uninformed":
                law = ModalPolicy(response, ModalSettings(), gains=0.5, thresholds=1e-4)
            return train_structured(response, settings, start=law, draw=drawing).policy
        case _:
            wanted: dict[str, Any] = {**row.change, "seed": seed}
            settings = TrajectorySettings(**wanted)
            start: NetworkPolicy | None = embed(modal) if row.start == "embedded" else None
            return train_trajectory(response, settings, start=start, draw=drawing).policy


class _Linear(Memoryless):
    def __init__(self, gain_matrix: Vector) -> None:
        self.gain_matrix = gain_matrix

    def changes(self, errors: Vector) -> Vector:
        return -errors @ self.gain_matrix.T


def _figures(curve: Vector) -> dict[str, float]:
    """Sum up the curves of one seed, shape (steps + 1, trajectories) [m]."""
    lost = ~(np.max(curve, axis=0) < _FAR)
    with np.errstate(over="ignore"):
        mean = np.mean(curve, axis=1)
        floor = np.sqrt(np.mean(curve[-_LATE:] ** 2))
    near = np.flatnonzero(mean < _NEAR)
    return {
        "floor": float(floor),
        "worst": float(np.max(curve[1:])),
        "steps": float(near[0]) if len(near) else np.inf,
        "diverged": float(np.mean(lost)),
    }


def _over_seeds(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Give medians, and the largest of every figure; null where it is not finite."""
    if not runs:
        return {}
    summed: dict[str, Any] = {}
    for key, first in runs[0].items():
        if isinstance(first, dict):
            summed[key] = _over_seeds([run[key] for run in runs])
        else:
            values = [run[key] for run in runs]
            pair = {"median": float(np.median(values)), "worst": max(values)}
            summed[key] = {k: v if np.isfinite(v) else None for k, v in pair.items()}
    return summed

"""The comparison of refits over seeds, drifts, noises and horizons, as one campaign."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector
from orbitfb.evaluate.campaign import Progress, run_tasks
from orbitfb.evaluate.pool.task import Task
from orbitfb.evaluate.refit import LAWS, RefitEvaluationSettings, evaluate_refit
from orbitfb.learn.settings import LearnSettings
from orbitfb.physics.places import Planes
from orbitfb.policies.svd import SvdSettings

TASK = "orbitfb.evaluate.grid:one_point"


class GridSettings(Settings):
    """Which points to evaluate: all combinations."""

    seeds: tuple[Annotated[int, Field(ge=0)], ...] = Field(
        default=(1, 2, 3), min_length=1, description="Seeds of ring, noise and drift."
    )
    drifts: tuple[Literal["none", "paper", "mild", "strong"], ...] = Field(
        default=("mild", "strong"), min_length=1, description="Drifts over the whole run."
    )
    noises: tuple[Annotated[float, Field(ge=0.0)], ...] = Field(
        default=(0.2e-6,), min_length=1, description="White noises of every BPM reading, rms [m]."
    )
    horizons: tuple[Annotated[int, Field(ge=600)], ...] = Field(
        default=(2000,), min_length=1, description="Lengths of a run [ticks]."
    )
    planes: Planes = Field(default="x", description="Planes under feedback.")
    start: Literal["true", "nominal", "drawn"] = Field(
        default="true", description="R̂ that all but `told` begin with, as `evaluate refit` has it."
    )
    policy: SvdSettings = Field(default=SvdSettings(), description="Gain and λ of all the laws.")
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")

    def points(self) -> list[RefitEvaluationSettings]:
        """Give every combination; the seed runs fastest."""
        common = self.model_dump(include={"planes", "start", "policy", "learn"})
        names = ("drift", "bpm_noise", "ticks", "seed")
        values = product(self.drifts, self.noises, self.horizons, self.seeds)
        return [
            RefitEvaluationSettings.model_validate(
                {**common, **dict(zip(names, point, strict=True))}
            )
            for point in values
        ]


@dataclass(frozen=True, slots=True)
class Spread:
    """A figure over seeds.

    Args:
        median: Of all seeds.
        low: Lowest.
        high: Highest.
    """

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> "Spread":
        """Take it over seeds."""
        return cls(float(np.median(values)), float(np.min(values)), float(np.max(values)))


@dataclass(frozen=True, slots=True)
class GridRow:
    """All seeds of one drift, noise and horizon.

    Args:
        drift: The drift.
        bpm_noise: Noise of the readings, rms [m].
        ticks: Length of the run.
        figures: By seed, those of `orbitfb.evaluate.refit.evaluate_refit`.
    """

    drift: str
    bpm_noise: float
    ticks: int
    figures: Mapping[int, Mapping[str, float]]

    def values(self, name: str) -> Vector:
        """Give a figure of every seed, shape (seeds,)."""
        return np.array([figures[name] for figures in self.figures.values()])

    def spreads(self) -> dict[str, Spread]:
        """Give the spread of every figure that all seeds have."""
        per_seed = list(self.figures.values())
        common = [name for name in per_seed[0] if all(name in other for other in per_seed)]
        return {name: Spread.of(self.values(name).tolist()) for name in common}


def one_point(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Evaluate one point: the task that a worker runs.

    Args:
        settings: Of `orbitfb.evaluate.refit`, as JSON.

    Returns:
        The figures, and the true orbit by law as arrays `true_rms_…` [m].
    """
    result = evaluate_refit(RefitEvaluationSettings.model_validate(settings))
    series = {f"true_rms_{law}": result.true_rms[law].astype(np.float32) for law in LAWS}
    return {"figures": dict(result.figures), **series}


def evaluate_grid(
    settings: GridSettings,
    directory: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = lambda done, total: None,
) -> list[GridRow]:
    """Evaluate all points.

    Args:
        settings: Which ones.
        directory: Where their results are kept and found again; None: in memory.
        workers: Local processes; None: one for each core.
        scheduler: Address of a Dask scheduler; None: local.
        progress: Told after every point.

    Returns:
        A row for every drift, noise and horizon.

    Raises:
        CampaignError: Points failed; the others are kept.
        ConfigError: There is no such cluster.
    """
    points = settings.points()
    tasks = [Task(TASK, {"settings": point.model_dump(mode="json")}) for point in points]
    results = run_tasks(tasks, directory, workers, scheduler, progress)
    rows: dict[tuple[str, float, int], dict[int, Mapping[str, float]]] = {}
    for point, result in zip(points, results, strict=True):
        where = (point.drift, point.bpm_noise, point.ticks)
        rows.setdefault(where, {})[point.seed] = result["figures"]
    return [GridRow(*where, figures) for where, figures in rows.items()]

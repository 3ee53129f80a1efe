"""Running the experiment: method × scenario × part of the trajectories, in parallel."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.evaluate.campaign import run_tasks
from orbitfb.evaluate.paper.bias import GAINS
from orbitfb.evaluate.paper.environment import Controller, Environment, simulate
from orbitfb.evaluate.paper.methods import GRID, HINDSIGHT, METHODS, find_method
from orbitfb.evaluate.paper.metrics import Summary, combine, figures, summarise
from orbitfb.evaluate.paper.scenarios import Scenario, make_scenario
from orbitfb.evaluate.paper.settings import PaperSettings
from orbitfb.evaluate.pool.task import Task

_SMALLEST_PART = 8
_PARTS = 8
_SEARCHED = 8
_SHORTEST_BIAS, _BIAS_TICKS = 500, 5000

Progress = Callable[[str, int, int], None]
"""Told what is done, how many tasks of it, of how many."""


@dataclass(frozen=True, slots=True)
class MethodResult:
    """What a method did in a scenario.

    Args:
        figures: `metrics.figures`, and `options` where some were chosen.
        summary: What they are made from.
        training: Curve and figures of a training before the run; empty if there was none.
    """

    figures: Mapping[str, Any]
    summary: Summary
    training: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class PaperResult:
    """The whole experiment.

    Args:
        settings: What was asked for.
        scenarios: By name, in the order of the table.
        methods: By scenario and method.
        bias: `bias.naive_bias` for every gain.
    """

    settings: PaperSettings
    scenarios: Mapping[str, Scenario]
    methods: Mapping[str, Mapping[str, MethodResult]]
    bias: Sequence[Mapping[str, float]]


def evaluate_paper(
    settings: PaperSettings,
    directory: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = lambda what, done, total: None,
) -> PaperResult:
    """Run the experiment.

    Args:
        settings: What to run.
        directory: Where the parts are kept and found again; None: in memory alone.
        workers: Local processes; None: one for each core.
        scheduler: Address of a Dask scheduler; None: local.
        progress: Told after every part.

    Raises:
        ConfigError: An unknown scenario or method, or the workers.
        CampaignError: Parts failed.
    """
    cells = [(scenario, method) for scenario in settings.scenarios for method in settings.methods]
    scenarios = {name: _make(settings, name) for name in settings.scenarios}
    tasks: list[Task] = []
    owners: list[tuple[str, str]] = []
    for scenario, method in sorted(cells, key=lambda cell: -find_method(cell[1]).cost):
        found = (
            _search(settings, scenario)
            if method == HINDSIGHT
            else _parts(settings, scenario, method, {})
        )
        tasks += found
        owners += [(scenario, method)] * len(found)

    def run(what: str, tasks: Sequence[Task]) -> list[dict[str, Any]]:
        return run_tasks(
            tasks, directory, workers, scheduler, lambda done, total: progress(what, done, total)
        )

    parts: dict[tuple[str, str], list[dict[str, Any]]] = {cell: [] for cell in cells}
    done = run("runs", [*tasks, *(_bias_task(settings, gain) for gain in GAINS)])
    bias = done[len(tasks) :]
    for cell, part in zip(owners, done, strict=False):
        parts[cell].append(part)
    options = {
        cell: _best(scenarios[cell[0]], parts[cell]) for cell in cells if cell[1] == HINDSIGHT
    }
    again = {cell: _parts(settings, *cell, chosen) for cell, chosen in options.items()}
    if again:
        results = iter(
            run("runs with the best λ", [task for few in again.values() for task in few])
        )
        for cell, few in again.items():
            parts[cell] = [next(results) for _ in few]
    methods: dict[str, dict[str, MethodResult]] = {name: {} for name in scenarios}
    for scenario, method in cells:
        cell = (scenario, method)
        methods[scenario][method] = _result(scenarios[scenario], parts[cell], options.get(cell, {}))
    return PaperResult(settings, scenarios, methods, bias)


def run_part(
    scenario: str,
    plane: Any,
    seed: int,
    steps: int,
    after: int,
    method: str,
    first: int,
    count: int,
    options: Mapping[str, Any],
    device: str,
) -> dict[str, Any]:
    """Run some trajectories of a method: the task of the campaign.

    Args:
        scenario: Its name.
        plane: `x` or `y`.
        seed: Of the scenario.
        steps: Length of the drift [ticks].
        after: Ticks after the re-kick [ticks].
        method: Its name.
        first: Number of the first trajectory.
        count: How many trajectories.
        options: Of the method.
        device: `auto`, `cpu` or `cuda`.

    Returns:
        The arrays of `Summary`, and `training` of the controller.
    """
    made = make_scenario(scenario, plane=plane, seed=seed, steps=steps, after=after)
    training: list[Any] = []

    def control(environment: Environment) -> Controller:
        controller = find_method(method).controller(environment, options, device)
        training.append(getattr(controller, "training", {}))
        return controller

    curves = simulate(made, range(first, first + count), control)
    return {**summarise(curves, steps).arrays(), "training": dict(training[0])}


def _make(settings: PaperSettings, name: str) -> Scenario:
    return make_scenario(
        name, plane=settings.plane, seed=settings.seed, steps=settings.steps, after=settings.after
    )


def _task(
    settings: PaperSettings,
    scenario: str,
    method: str,
    part: tuple[int, int],
    options: Mapping[str, Any],
) -> Task:
    arguments = {
        "scenario": scenario,
        "plane": settings.plane,
        "seed": settings.seed,
        "steps": settings.steps,
        "after": settings.after,
        "method": method,
        "first": part[0],
        "count": part[1],
        "options": dict(options),
        "device": settings.device,
    }
    return Task("orbitfb.evaluate.paper.run:run_part", arguments)


def _parts(
    settings: PaperSettings, scenario: str, method: str, options: Mapping[str, Any]
) -> list[Task]:
    """Cut the trajectories of a method into tasks; the cut does not depend on the machine."""
    chosen = METHODS[method]
    total = settings.static_trajectories if chosen.static else settings.trajectories
    size = total if chosen.whole else max(_SMALLEST_PART, -(-total // _PARTS))
    cuts = [(first, min(size, total - first)) for first in range(0, total, size)]
    return [_task(settings, scenario, method, cut, options) for cut in cuts]


def _bias_task(settings: PaperSettings, gain: float) -> Task:
    arguments = {
        "gain": gain,
        "plane": settings.plane,
        "seed": settings.seed,
        "ticks": max(_SHORTEST_BIAS, min(_BIAS_TICKS, settings.steps)),
    }
    return Task("orbitfb.evaluate.paper.bias:naive_bias", arguments)


def _search(settings: PaperSettings, scenario: str) -> list[Task]:
    few = (0, min(_SEARCHED, settings.static_trajectories))
    return [_task(settings, scenario, HINDSIGHT, few, options) for options in GRID]


def _best(scenario: Scenario, parts: Sequence[Mapping[str, Any]]) -> Mapping[str, float]:
    """Find the options that left the smallest orbit at the end of the drift."""
    ends = [figures(combine([part]), scenario)["final_true_rms_mm"] for part in parts]
    return GRID[int(np.argmin(ends))]


def _result(
    scenario: Scenario, parts: Sequence[Mapping[str, Any]], options: Mapping[str, Any]
) -> MethodResult:
    summary = combine(parts)
    found = figures(summary, scenario)
    if options:
        found["options"] = dict(options)
    return MethodResult(found, summary, parts[0]["training"])

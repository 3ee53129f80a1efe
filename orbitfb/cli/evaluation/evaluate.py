"""Commands that measure what a method is worth."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.evaluation.paper import evaluate_paper_command
from orbitfb.cli.options import (
    ConfigFile,
    Drift,
    EffectsFile,
    EffectSpecs,
    PolicyKind,
    chosen_effects,
    configure,
    make_out,
    show,
    validated,
)

evaluate = typer.Typer(help="Compare methods by experiments.", no_args_is_help=True)
evaluate.command("paper")(evaluate_paper_command)


@evaluate.command("refit")
def evaluate_refit_command(
    out: Annotated[Path, typer.Option(help="Directory for refit.json and refit.png.")],
    drift: Drift = "none",
    no_drift: Annotated[
        bool, typer.Option("--no-drift", help="The same as --drift none, the default.")
    ] = False,
    ticks: Annotated[int, typer.Option(help="Length of each run [ticks].")] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of ring, noise and drift.")] = 1,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
) -> None:
    """Refits of the learner beside naive ones, a frozen and a true response, in process."""
    from orbitfb.evaluate.refit import RefitEvaluationSettings, evaluate_refit, write

    settings = configure(config_file, effect=chosen_effects(effect, effects), effects_file=effects)
    asked = {"drift": "none" if no_drift else drift, "ticks": ticks, "seed": seed}
    common = {
        "planes": settings.ring.planes,
        "policy": settings.policy.svd,
        "learn": settings.learn,
        "effects": settings.effect,
        "period": settings.loop.period,
    }
    asked_for = validated(RefitEvaluationSettings, {**asked, **common})
    make_out(out)
    result = evaluate_refit(asked_for, say_begun)
    write(result, out)
    show({**result.figures}, as_json=False)
    print(f"written: {out / 'refit.json'}, {out / 'refit.png'}")


@evaluate.command("live")
def evaluate_live_command(
    out: Annotated[Path, typer.Option(help="Directory for live.json and live.png.")],
    drift: Drift = "strong",
    ticks: Annotated[int, typer.Option(help="Length of each run [ticks].")] = 6000,
    seed: Annotated[int, typer.Option(help="First seed of ring, noise and drift.")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = 3,
    policy: PolicyKind = None,
    rate: Annotated[
        float | None,
        typer.Option(
            help="Ticks per second, the learner a thread as in operation [ring and loop in "
            "lockstep, as fast as they go]."
        ),
    ] = None,
    at_once: Annotated[
        int,
        typer.Option(
            min=1, help="Runs side by side, each in a process of its own: three for every seed."
        ),
    ] = 1,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
) -> None:
    """The learner in the real loop over Channel Access, on a drifting ring."""
    from orbitfb.evaluate.live import evaluate_live, figures
    from orbitfb.evaluate.live_report import LiveResult, write
    from orbitfb.evaluate.live_settings import LiveSettings

    settings = configure(
        config_file,
        policy__kind=policy,
        effect=chosen_effects(effect, effects),
        effects_file=effects,
    )
    common = {
        "planes": settings.ring.planes,
        "policy": settings.policy,
        "learn": settings.learn,
        "effects": settings.effect,
    }
    asked = {"drift": drift, "ticks": ticks, "rate_hz": rate, **common}
    each = [
        validated(LiveSettings, {**asked, "seed": number}) for number in range(seed, seed + seeds)
    ]
    results: list[LiveResult] = []
    for live, runs in evaluate_live(each, print, at_once):
        results.append(LiveResult(live, runs))
        show({"seed": live.seed, **figures(runs)}, as_json=False)
        write(results, out)
    print(f"written: {out / 'live.json'}, {out / 'live.png'}")


@evaluate.command("campaign")
def evaluate_campaign_command(
    out: Annotated[
        Path,
        typer.Option(
            help="Directory for campaign.json, campaign.md, campaign.png and the result of every "
            "point; the same command there goes on where it was interrupted."
        ),
    ],
    seed: Annotated[int, typer.Option(help="First seed of ring, noise and drift.")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = 3,
    drift: Annotated[
        list[str] | None,
        typer.Option(
            help="Drift: none, paper, mild or strong; may be given again [mild and strong]."
        ),
    ] = None,
    noise: Annotated[
        list[float] | None,
        typer.Option(help="BPM noise, rms [m]; may be given again [0.2e-6]."),
    ] = None,
    ticks: Annotated[
        list[int] | None,
        typer.Option(help="Length of each run [ticks]; may be given again [2000]."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="Local processes; 1: this one [one for each core].")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler whose workers run the points [local]."),
    ] = None,
    config_file: ConfigFile = None,
) -> None:
    """Refits in process over all combinations of seeds, drifts, noises and horizons."""
    from orbitfb.evaluate.grid import GridSettings, evaluate_grid
    from orbitfb.evaluate.grid_report import table, write

    settings = configure(config_file)
    given = {"drifts": drift, "noises": noise, "horizons": ticks}
    asked = {name: tuple(values) for name, values in given.items() if values}
    common = {
        "planes": settings.ring.planes,
        "policy": settings.policy.svd,
        "learn": settings.learn,
    }
    numbers = tuple(range(seed, seed + seeds))
    grid = validated(
        GridSettings,
        {"seeds": numbers, **asked, **common},
        seeds="seed",
        drifts="drift",
        noises="noise",
        horizons="ticks",
    )
    make_out(out)
    rows = evaluate_grid(grid, out / "points", workers, scheduler, _tell)
    write(grid, rows, out)
    print(table(grid, rows))
    print(f"written: {out / 'campaign.json'}, {out / 'campaign.md'}, {out / 'campaign.png'}")


def say_begun(what: str) -> None:
    """Say what begins: on standard error, as it is no result."""
    print(what, file=sys.stderr, flush=True)


def _tell(done: int, total: int) -> None:
    print(f"{done} of {total} points done", flush=True)

"""The command line: thin; what a command needs is imported when it runs."""

import json
import os
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from orbitfb import __version__
from orbitfb.core.errors import OrbitFeedbackError

if TYPE_CHECKING:
    from orbitfb.config import AppConfig
    from orbitfb.core.settings import Settings

S = TypeVar("S", bound="Settings")

app = typer.Typer(
    name="orbitfb",
    help="Adaptive orbit feedback for synchrotron light sources on an EPICS control network.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
policies = typer.Typer(help="Policies in the store of a data directory.", no_args_is_help=True)
evaluate = typer.Typer(help="Measure what a method is worth.", no_args_is_help=True)
config = typer.Typer(help="Print and check the configuration.", no_args_is_help=True)
app.add_typer(policies, name="policies")
app.add_typer(evaluate, name="evaluate")
app.add_typer(config, name="config")

ConfigFile = Annotated[Path | None, typer.Option("--config", help="Configuration file (TOML).")]
DataDirectory = Annotated[
    Path | None, typer.Option("--data", help="Data directory [orbitfb-data].")
]
Planes = Annotated[str | None, typer.Option(help="Planes under feedback: x, y or xy [x].")]
Seed = Annotated[int | None, typer.Option(help="Seed of the simulated ring and of the dither.")]
Rate = Annotated[float | None, typer.Option(help="Ticks per second, loop and soft IOC [10].")]
Port = Annotated[int | None, typer.Option(help="Port of the soft IOC; 0: any free one [15064].")]
Drift = Annotated[
    str | None, typer.Option(help="Drift of the simulated ring: none, paper, mild, strong.")
]
DriftTicks = Annotated[int | None, typer.Option(help="Ticks that the drift takes.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON.")]


def main() -> None:
    """Run the command line; a known error is printed without a traceback and exits with 2."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its spinning threads disturb the tick
    try:
        app()
    except OrbitFeedbackError as error:
        print(f"orbitfb: {error}", file=sys.stderr)
        sys.exit(2)


def _configure(path: Path | None, **options: Any) -> "AppConfig":
    from orbitfb.config import load_config

    return load_config(path, {name.replace("__", "."): value for name, value in options.items()})


def _validated(model: type[S], values: dict[str, Any]) -> S:
    """Build settings of a command; what is wrong is named by its option."""
    from pydantic import ValidationError

    from orbitfb.core.errors import ConfigError

    try:
        return model.model_validate(values)
    except ValidationError as error:
        problems = [
            f"--{'-'.join(str(part) for part in problem['loc'])}: {problem['msg']}, "
            f"got {problem['input']!r}"
            for problem in error.errors()
        ]
        raise ConfigError("; ".join(problems)) from None


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_version, is_eager=True),
    ] = False,
) -> None:
    """Take the options that stand before any command."""


@app.command()
def run(
    ioc: Annotated[
        str,
        typer.Option(
            help="sim: a simulated ring as a child process; HOST[:PORT]: an IOC that runs there "
            "[port 15064]; env: what the EPICS_CA_… environment says; config: what [epics] of the "
            "configuration says."
        ),
    ],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    rate: Rate = None,
    seed: Seed = None,
    duration: Annotated[
        float | None, typer.Option(help="Stop after so many seconds [until Ctrl-C].")
    ] = None,
    start: Annotated[
        str | None,
        typer.Option(help="State to start in: open, shadow or closed [sim: closed, else open]."),
    ] = None,
    summary: Annotated[
        Path | None, typer.Option(help="Write a summary of the run to this file (JSON).")
    ] = None,
    port: Port = None,
    drift: Drift = None,
    drift_ticks: DriftTicks = None,
    metrics_port: Annotated[
        int | None, typer.Option(help="Port of /metrics; 0: any free one [9180].")
    ] = None,
) -> None:
    """Close the loop: read the orbit, correct it, learn from it."""
    from orbitfb.service import run_service

    settings = _configure(
        config_file,
        data_directory=data,
        ring__planes=planes,
        loop__rate_hz=rate,
        sim__rate_hz=rate,
        seed=seed,
        sim__port=port,
        plant__drift__preset=drift,
        plant__drift__ticks=drift_ticks,
        observe__port=metrics_port,
    )
    announce = partial(print, flush=True)
    raise typer.Exit(run_service(settings, ioc, start, duration, summary, announce))


@app.command()
def ioc(
    config_file: ConfigFile = None,
    planes: Planes = None,
    rate: Rate = None,
    seed: Seed = None,
    port: Port = None,
    drift: Drift = None,
    drift_ticks: DriftTicks = None,
    plain: Annotated[
        bool | None,
        typer.Option("--plain", help="Serve by caproto's documented calls alone (slow reference)."),
    ] = None,
    lockstep: Annotated[
        bool | None,
        typer.Option(
            "--lockstep", help="Advance as soon as every setpoint was written (accelerated clock)."
        ),
    ] = None,
) -> None:
    """Serve the simulated ring as a soft IOC until Ctrl-C."""
    from orbitfb.maintenance import sim_job
    from orbitfb.sim.process import run_job

    settings = _configure(
        config_file,
        ring__planes=planes,
        sim__rate_hz=rate,
        seed=seed,
        sim__port=port,
        sim__plain=plain,
        sim__lockstep=lockstep,
        plant__drift__preset=drift,
        plant__drift__ticks=drift_ticks,
    )
    where = settings.sim.interface

    def announce(taken: int, pvs: int) -> None:
        reach = "this computer only" if where.startswith("127.") else "the network"
        print(f"serving {pvs} PVs on {where}, port {taken}, to {reach}; Ctrl-C stops", flush=True)
        print(f"  EPICS_CA_ADDR_LIST={where} EPICS_CA_AUTO_ADDR_LIST=NO ", end="")
        print(f"EPICS_CA_SERVER_PORT={taken}", flush=True)

    run_job(sim_job(settings), announce)


@app.command()
def refit(
    archive: Annotated[
        Path | None,
        typer.Option("--from", help="Refit from this archive; without it, ask the service."),
    ] = None,
    activate: Annotated[
        bool, typer.Option("--activate", help="Activate the candidate if the judge accepts it.")
    ] = False,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Identify the response matrix anew, judge the policy built on it, print the decision."""
    from orbitfb.maintenance import refit_offline, refit_online

    settings = _configure(config_file, data_directory=data, ring__planes=planes)
    report = (
        refit_online(settings, activate)
        if archive is None
        else refit_offline(settings, archive, activate)
    )
    _show(report, as_json)


@app.command()
def command(
    name: Annotated[str, typer.Argument(help="open, shadow, close, reset or status.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    as_json: AsJson = False,
) -> None:
    """Command the running service."""
    from orbitfb.control import ask

    settings = _configure(config_file, data_directory=data)
    _show(ask(settings.data_directory, {"command": name}), as_json)


@policies.command("list")
def policies_list(
    config_file: ConfigFile = None, data: DataDirectory = None, as_json: AsJson = False
) -> None:
    """List the stored policies; the active one is starred."""
    from orbitfb.maintenance import list_policies

    rows = list_policies(_configure(config_file, data_directory=data))
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        star = "*" if row["active"] else " "
        print(f"{star} {row['id']:<24} {row['created']}  parent {row['parent'] or '-'}")
        if row["damage"]:
            print(f"    {row['damage']}")
    if not rows:
        print("no policies stored yet: `orbitfb run` stores its baseline, a refit its candidates")


@policies.command("show")
def policies_show(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
) -> None:
    """Print the card of a policy."""
    from orbitfb.maintenance import show_policy

    print(json.dumps(show_policy(_configure(config_file, data_directory=data), policy), indent=2))


@policies.command("activate")
def policies_activate(
    policy: Annotated[str, typer.Argument(help="Id of the policy.")],
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
) -> None:
    """Make a policy the active one, in the running service too if there is one."""
    from orbitfb.maintenance import activate_policy

    settings = _configure(config_file, data_directory=data, ring__planes=planes)
    _show(activate_policy(settings, policy), as_json=False)


@policies.command("rollback")
def policies_rollback(
    config_file: ConfigFile = None, data: DataDirectory = None, planes: Planes = None
) -> None:
    """Go back to the policy that was active before."""
    from orbitfb.maintenance import activate_policy

    settings = _configure(config_file, data_directory=data, ring__planes=planes)
    _show(activate_policy(settings, None), as_json=False)


@evaluate.command("refit")
def evaluate_refit_command(
    out: Annotated[Path, typer.Option(help="Directory for refit.json and refit.png.")],
    drift: Drift = "none",
    no_drift: Annotated[
        bool, typer.Option("--no-drift", help="The same as --drift none, the default.")
    ] = False,
    ticks: Annotated[int, typer.Option(help="Length of each run [ticks].")] = 4000,
    seed: Annotated[int, typer.Option(help="Seed of ring, noise and drift.")] = 1,
    config_file: ConfigFile = None,
) -> None:
    """Refits of the learner beside naive ones, a frozen and a true response, in process."""
    from orbitfb.evaluate.refit import RefitEvaluationSettings, evaluate_refit, write

    settings = _configure(config_file)
    asked = {"drift": "none" if no_drift else drift, "ticks": ticks, "seed": seed}
    common = {"planes": settings.ring.planes, "policy": settings.policy, "learn": settings.learn}
    result = evaluate_refit(_validated(RefitEvaluationSettings, {**asked, **common}))
    write(result, out)
    _show({**result.figures}, as_json=False)
    print(f"written: {out / 'refit.json'}, {out / 'refit.png'}")


@evaluate.command("live")
def evaluate_live_command(
    out: Annotated[Path, typer.Option(help="Directory for live.json and live.png.")],
    drift: Drift = "strong",
    ticks: Annotated[int, typer.Option(help="Length of each run [ticks].")] = 6000,
    seed: Annotated[int, typer.Option(help="First seed of ring, noise and drift.")] = 1,
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = 3,
    rate: Annotated[float, typer.Option(help="Ticks per second: an accelerated clock.")] = 100.0,
    config_file: ConfigFile = None,
) -> None:
    """The learner in the real loop over Channel Access, on a drifting ring."""
    from orbitfb.evaluate.live import LiveSettings, evaluate_live, figures
    from orbitfb.evaluate.live_report import LiveResult, write

    settings = _configure(config_file)
    common = {"planes": settings.ring.planes, "policy": settings.policy, "learn": settings.learn}
    results: list[LiveResult] = []
    for number in range(seed, seed + seeds):
        asked = {"drift": drift, "ticks": ticks, "seed": number, "rate_hz": rate}
        live = _validated(LiveSettings, {**asked, **common})
        results.append(LiveResult(live, evaluate_live(live, print)))
        _show({"seed": number, **figures(results[-1].runs)}, as_json=False)
        write(results, out)
    print(f"written: {out / 'live.json'}, {out / 'live.png'}")


@config.command("show")
def config_show(config_file: ConfigFile = None) -> None:
    """Print the configuration in force as TOML, each key with its meaning."""
    from orbitfb.config import to_toml

    print(to_toml(_configure(config_file)))


@config.command("check")
def config_check(path: Annotated[Path, typer.Argument(help="Configuration file (TOML).")]) -> None:
    """Say whether a configuration file is good, its ring included."""
    _configure(path).ring.load()
    print(f"{path}: good")


@config.command("schema")
def config_schema() -> None:
    """Print the JSON schema of the configuration."""
    from orbitfb.config import AppConfig

    print(json.dumps(AppConfig.model_json_schema(), indent=2))


def _show(answer: dict[str, Any], as_json: bool) -> None:
    from orbitfb import tabulate

    print(tabulate.as_json(answer) if as_json else tabulate.as_text(answer))

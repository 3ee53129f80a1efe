"""Commands around the service: run it, serve a ring to it, ask it."""

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    DataDirectory,
    Drift,
    DriftTicks,
    EffectsFile,
    EffectSpecs,
    Ioc,
    Planes,
    PolicyKind,
    Port,
    Rate,
    Seed,
    chosen_effects,
    configure,
    data_directory,
    pairs,
    show,
)


def run(
    ioc: Ioc,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    policy: PolicyKind = None,
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
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    excite: Annotated[
        Path | None,
        typer.Option(
            help="Play the excitation in this file once after the loop has closed (TOML or .npz, "
            "from `orbitfb diagnose plan`); it is logged as dither."
        ),
    ] = None,
    metrics_port: Annotated[
        int | None, typer.Option(help="Port of /metrics; 0: any free one [9180].")
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="Run on a real machine. The loop starts OPEN and waits for the command close. "
            "Without this option the production port 5064 is refused.",
        ),
    ] = False,
) -> None:
    """Close the loop: read the orbit, correct it, learn from it."""
    if sys.stderr.isatty():  # what is started is told on standard output when it is there
        print("starting …", file=sys.stderr, flush=True)
    from orbitfb.app.service.run import run_service
    from orbitfb.app.setup.startup import SIMULATED
    from orbitfb.core.errors import ConfigError

    chosen = chosen_effects(effect, effects)
    if chosen is not None and ioc != SIMULATED:
        raise ConfigError(
            f"--effect and --effects are of a simulated ring, but --ioc is {ioc}; give them to "
            "the `orbitfb ioc` that serves it, or run with --ioc sim"
        )
    settings = configure(
        config_file,
        data_directory=data,
        ring__planes=planes,
        policy__kind=policy,
        loop__rate_hz=rate,
        sim__rate_hz=rate,
        seed=seed,
        sim__port=port,
        plant__drift__preset=drift,
        plant__drift__ticks=drift_ticks,
        effect=chosen,
        effects_file=effects,
        observe__port=metrics_port,
    )
    asked = policy is not None
    raise typer.Exit(
        run_service(settings, ioc, start, duration, summary, _tell, excite, live, asked)
    )


def _tell(line: str) -> None:
    """Print a line; a reader that has gone (`| head -1`, a closed window) must not end the loop."""
    try:
        print(line, flush=True)
    except OSError:  # a broken pipe, or no such terminal any more
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def ioc(
    config_file: ConfigFile = None,
    planes: Planes = None,
    rate: Rate = None,
    seed: Seed = None,
    port: Port = None,
    drift: Drift = None,
    drift_ticks: DriftTicks = None,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    plain: Annotated[
        bool | None,
        typer.Option("--plain", help="Use only documented calls of caproto (slow reference)."),
    ] = None,
    lockstep: Annotated[
        bool | None,
        typer.Option(
            "--lockstep",
            help="Advance as soon as a client has written its setpoints (accelerated clock).",
        ),
    ] = None,
) -> None:
    """Serve the simulated ring as a soft IOC until Ctrl-C."""
    from orbitfb.app.setup.stored_policies import sim_job
    from orbitfb.sim.process import run_job
    from orbitfb.sim.served import Served

    settings = configure(
        config_file,
        ring__planes=planes,
        sim__rate_hz=rate,
        seed=seed,
        sim__port=port,
        sim__plain=plain,
        sim__lockstep=lockstep,
        plant__drift__preset=drift,
        plant__drift__ticks=drift_ticks,
        effect=chosen_effects(effect, effects),
        effects_file=effects,
    )
    where = settings.sim.interface

    def announce(served: Served) -> None:
        taken, pvs = served.port, served.pvs
        reach = "this computer only" if where.startswith("127.") else "the network"
        print(f"serving {pvs} PVs on {where}, port {taken}, to {reach}; Ctrl-C stops", flush=True)
        print(f"  EPICS_CA_ADDR_LIST={where} EPICS_CA_AUTO_ADDR_LIST=NO ", end="")
        print(f"EPICS_CA_SERVER_PORT={taken}", flush=True)
        if served.pva_port:
            print(f"  EPICS_PVA_ADDR_LIST={where} EPICS_PVA_AUTO_ADDR_LIST=NO ", end="")
            print(f"EPICS_PVA_BROADCAST_PORT={served.pva_port}", flush=True)

    run_job(sim_job(settings), announce)


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
    policy: PolicyKind = None,
    as_json: AsJson = False,
) -> None:
    """Identify the response matrix again, judge the policy built on it, print the decision."""
    from orbitfb.app.setup.stored_policies import refit_offline, refit_online

    settings = configure(config_file, data_directory=data, ring__planes=planes, policy__kind=policy)
    report = (
        refit_online(settings, activate)
        if archive is None
        else refit_offline(settings, archive, activate)
    )
    show(report, as_json)


def command(
    name: Annotated[
        str,
        typer.Argument(
            help="open, shadow, close, reset, postmortem, status, or a command named below."
        ),
    ],
    values: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY=VALUE",
            help="Values for gain (plane=x value=0.5), dither (orbit_cost=1e-6), try "
            "(singular_values=120 regularisation=1e-5, of one plane with plane=y; then "
            "apply), reference (values=[…], m), reference-save and reference-load "
            "(name=golden), enable-bpms and enable-correctors (enabled=[true, …]), correct "
            "(law=active; then correct-apply, or undo), bump (place=NAME plane=x "
            "position=1e-4 angle=0, m and rad), average (orbits=10), dead-band (plane=x "
            "value=1e-6, m), measure (action=start, abort or status; at_once=0, fresh=true).",
        ),
    ] = None,
    once: Annotated[
        bool, typer.Option("--once", help="With correct: apply the computed correction once.")
    ] = False,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    as_json: AsJson = False,
) -> None:
    """Command the running service."""
    from orbitfb.app.commands.requests import check_request
    from orbitfb.control.client import ask

    request = {**pairs(values or []), "command": name, **({"once": True} if once else {})}
    check_request(request)
    show(ask(data_directory(config_file, data), request), as_json)

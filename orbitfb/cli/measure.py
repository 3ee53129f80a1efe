"""The command that measures the response matrix."""

import sys
from functools import partial
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
    Port,
    Rate,
    Seed,
    chosen_effects,
    configure,
    show,
)


def measure_response_command(
    ioc: Ioc,
    out: Annotated[
        Path | None,
        typer.Option(
            help="File of the matrix (safetensors), for `ring.response` of the configuration "
            "[response-<time>.safetensors in the data directory]."
        ),
    ] = None,
    at_once: Annotated[
        int | None,
        typer.Option(
            help="Correctors that move at once, each at a frequency of its own; 0: all of them; "
            "1: one by one, by steps [1]."
        ),
    ] = None,
    amplitude: Annotated[
        float | None,
        typer.Option(
            help="Largest step, of either sign [A] [the step that moves the orbit by 50 µm rms]."
        ),
    ] = None,
    fresh: Annotated[
        bool,
        typer.Option(
            "--fresh", help="Start again instead of continuing an interrupted measurement."
        ),
    ] = False,
    restore: Annotated[
        bool,
        typer.Option(
            "--restore", help="Restore setpoints that a killed measurement left moved [asks]."
        ),
    ] = False,
    leave: Annotated[
        bool, typer.Option("--leave", help="Leave such setpoints where they are [asks].")
    ] = False,
    activate: Annotated[
        bool,
        typer.Option(
            "--activate",
            help="Make a policy of the matrix, store it, put it in force; refused if a column or "
            "row is bad.",
        ),
    ] = False,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="Measure a real machine. Without this option the production port 5064 is refused.",
        ),
    ] = False,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    rate: Rate = None,
    seed: Seed = None,
    port: Port = None,
    drift: Drift = None,
    drift_ticks: DriftTicks = None,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    as_json: AsJson = False,
) -> None:
    """Measure the response matrix around the present setpoints, then restore them."""
    from orbitfb.app.measure.command import MeasureRequest, measure_response
    from orbitfb.app.measure.stopping import StopRequests
    from orbitfb.core.errors import ConfigError, StoppedError

    if restore and leave:
        raise ConfigError(
            "--restore puts back setpoints that a killed measurement moved, --leave leaves them; "
            "give one of the two, or neither to be asked"
        )
    chosen = chosen_effects(effect, effects)
    if chosen is not None and ioc != "sim":
        raise ConfigError(
            f"--effect and --effects are of a simulated ring, but --ioc is {ioc}; give them to "
            "the `orbitfb ioc` that serves it, or measure with --ioc sim"
        )
    settings = configure(
        config_file,
        data_directory=data,
        ring__planes=planes,
        loop__rate_hz=rate,
        sim__rate_hz=rate,
        seed=seed,
        sim__port=port,
        plant__drift__preset=drift,
        plant__drift__ticks=drift_ticks,
        effect=chosen,
        measure__at_once=at_once,
        measure__amplitude=amplitude,
    )
    say = partial(print, file=sys.stderr if as_json else sys.stdout, flush=True)
    stop = StopRequests()

    def confirm(question: str) -> bool:
        stop.at_once = True
        try:
            return typer.confirm(question)
        finally:
            stop.at_once = False

    asker = confirm if sys.stdin.isatty() else None
    with stop:
        try:
            put_back = restore if restore or leave else None
            request = MeasureRequest(ioc, out, fresh, put_back, activate, live)
            answer = measure_response(settings, request, stop, say, asker)
        except StoppedError as stopped:
            print(
                f"orbitfb: {stopped}; the setpoints are back; start it again to go on",
                file=sys.stderr,
            )
            raise typer.Exit(128 + stop.number) from None
    show(answer, as_json)
    if answer["bad_correctors"] or answer["bad_bpms"]:
        raise typer.Exit(1)

"""The command for the first call to support."""

import sys
from typing import Annotated

import typer

from orbitfb.cli.options import AsJson, ConfigFile, DataDirectory, Planes


def doctor(
    ioc: Annotated[
        str | None,
        typer.Option(
            "--ioc",
            help="Ring whose PVs to search for: HOST[:PORT] [port 15064]; env: by the EPICS_CA_… "
            "environment; config: by [epics] of the configuration [none].",
        ),
    ] = None,
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help=(
                "Search on a real machine. Without this option port 5064 and other hosts are "
                "refused."
            ),
        ),
    ] = False,
    deadline: Annotated[float, typer.Option(help="Longest wait for all PVs together [s].")] = 5.0,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Check program, configuration, files, clock, ports and ring; exit code 1 if a check fails.

    Nothing is written to any PV.
    """
    from orbitfb.app.doctor.examine import examine
    from orbitfb.app.doctor.finding import as_answer, as_text, healthy
    from orbitfb.cli import text
    from orbitfb.core.errors import ConfigError

    if not 0 < deadline <= 3600:
        raise ConfigError(f"--deadline {deadline:g}: give seconds above 0, at most 3600")
    if ioc is not None and ioc != "sim":
        searching = (
            f"searching for the PVs of the ring, {deadline:g} s at most, then listening to them"
        )
        print(searching, file=sys.stderr, flush=True)
    options = {"data_directory": data, "ring.planes": planes}
    found = examine(config_file, options, ioc, live, deadline)
    print(text.as_json(as_answer(found)) if as_json else as_text(found))
    if not healthy(found):
        raise typer.Exit(1)

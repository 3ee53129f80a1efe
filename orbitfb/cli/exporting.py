"""Commands that hand on what this program recorded and learned."""

from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.duration import tells_its_time
from orbitfb.cli.options import AsJson, ConfigFile, DataDirectory, Planes, configure, show

exporting = typer.Typer(
    help="Write the archive as Parquet, a response matrix as CSV, HDF5 or MATLAB.",
    no_args_is_help=True,
)


@exporting.command("response")
@tells_its_time("writing the response")
def export_response_command(
    origin: Annotated[
        str | None,
        typer.Argument(
            help="Id of a stored policy, whose R̂ is written, or a measured response "
            "(.safetensors) [the active policy]."
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option("--out", "-o", help="File to write: .csv, .h5 or .mat.")
    ] = Path("response.csv"),
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Write a response matrix, its names and its unit for other programs."""
    from orbitfb.app.setup import stored_policies
    from orbitfb.exchange.response.export import (
        export_response,
        response_of_file,
        response_of_policy,
    )

    settings = configure(config_file, data_directory=data, ring__planes=planes)
    channels = settings.ring.load().channels(settings.ring.planes)
    if origin is not None and (origin.endswith(".safetensors") or Path(origin).is_file()):
        exported = response_of_file(Path(origin), channels)
    else:
        exported = response_of_policy(stored_policies.open_store(settings), origin, channels)
    show(export_response(exported, channels, out), as_json)


@exporting.command("archive")
@tells_its_time("writing the archive")
def export_archive_command(
    archive: Annotated[
        Path | None,
        typer.Argument(help="A segment, or a directory of them [that of the data directory]."),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="File to write: .parquet.")] = Path(
        "archive.parquet"
    ),
    skip_corrupt: Annotated[
        bool, typer.Option("--skip-corrupt", help="Leave out segments that cannot be read.")
    ] = False,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    as_json: AsJson = False,
) -> None:
    """Write the archive as one Parquet file, a row for every tick."""
    from importlib.util import find_spec

    from orbitfb.core.errors import ConfigError

    if find_spec("pyarrow") is None:
        raise ConfigError("Parquet needs the extra 'parquet': pip install 'orbitfb[parquet]'")
    from orbitfb.exchange.orbits.parquet import export_archive

    settings = configure(config_file, data_directory=data)
    source = archive or settings.data_directory / "archive"
    show(export_archive(source, out, skip_corrupt), as_json)

"""Commands that take what was measured or recorded elsewhere."""

from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.duration import tells_its_time
from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    PlacesTable,
    Planes,
    RingParameters,
    configure,
    show,
)

importing = typer.Typer(
    help="Import response matrices and orbit histories from HDF5, CSV, MATLAB or an archiver, "
    "and lattices of Accelerator Toolbox.",
    no_args_is_help=True,
)

BpmNames = Annotated[
    str | None,
    typer.Option(
        help="Names of the BPMs: a path in the file, or @FILE for a text file with one name per "
        "line [above or before the table, in CSV]."
    ),
]
CorrectorNames = Annotated[
    str | None, typer.Option(help="Names of the correctors, in the same way.")
]
Order = Annotated[
    str,
    typer.Option(
        help="names: find devices by their names; table: the file has no names, its order is "
        "that of the places table, x and then y."
    ),
]
Anyway = Annotated[
    bool, typer.Option("--anyway", help="Accept a size or shape that is not plausible.")
]


@importing.command("response")
@tells_its_time("reading the response")
def import_response_command(
    file: Annotated[Path, typer.Argument(help="HDF5, CSV or MATLAB file (.mat, any version).")],
    out: Annotated[
        Path,
        typer.Option("--out", "-o", help="File for `ring.response` (safetensors)."),
    ] = Path("response.safetensors"),
    matrix: Annotated[
        str | None,
        typer.Option(
            help="Path of the matrix within the file: RM.data, /measured/R, Rmat(1,1).Data [CSV: "
            "the table]."
        ),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(
            help="Unit of the matrix: m/A, mm/A, um/A, mm/mA, m/rad, mm/mrad, … [as the file says]."
        ),
    ] = None,
    bpm_names: BpmNames = None,
    corrector_names: CorrectorNames = None,
    order: Order = "names",
    sigma: Annotated[
        str | None, typer.Option(help="Path of its standard deviations, in the same unit.")
    ] = None,
    transpose: Annotated[
        bool, typer.Option("--transpose", help="Its rows are correctors, its columns BPMs.")
    ] = False,
    anyway: Anyway = False,
    config_file: ConfigFile = None,
    planes: Planes = None,
    places: PlacesTable = None,
    ring: RingParameters = None,
    as_json: AsJson = False,
) -> None:
    """Import a response matrix that was measured elsewhere; exit code 1 if a part is bad."""
    from orbitfb.app.setup.loop_in_force import loop_of
    from orbitfb.exchange.response.parts import ResponseRequest
    from orbitfb.exchange.response.reading import import_response

    settings = configure(
        config_file, ring__planes=planes, ring__places=places, ring__parameters=ring
    )
    request = ResponseRequest(
        file, out, matrix, bpm_names, corrector_names, order, unit, sigma, transpose, anyway
    )
    ring_now = settings.ring.load()
    answer = import_response(
        request, ring_now, settings.ring.planes, settings.measure, loop_of(settings, ring_now)
    )
    show(answer, as_json)
    if answer["bad_correctors"] or answer["bad_bpms"]:
        raise typer.Exit(1)


@importing.command("history")
@tells_its_time("reading the history")
def import_history_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="HDF5, CSV or MATLAB file, or the JSON of an EPICS Archiver Appliance (several)."
        ),
    ],
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The record for `orbitfb diagnose` (HDF5).")
    ] = Path("history.h5"),
    time: Annotated[
        str | None, typer.Option(help="Path of the time within the file [CSV: column time].")
    ] = None,
    orbit: Annotated[str | None, typer.Option(help="Path of the orbits, one row per tick.")] = None,
    setpoints: Annotated[
        str | None, typer.Option(help="Path of the setpoints in force when the orbit was read.")
    ] = None,
    bpm_names: BpmNames = None,
    corrector_names: CorrectorNames = None,
    order: Order = "names",
    time_unit: Annotated[
        str | None, typer.Option(help="s, ms, us, ns, or datenum of MATLAB [as the file says].")
    ] = None,
    orbit_unit: Annotated[
        str | None, typer.Option(help="m, mm, um or nm [as the file or EGU says].")
    ] = None,
    setpoint_unit: Annotated[
        str | None, typer.Option(help="A or mA [as the file or EGU says].")
    ] = None,
    time_zone: Annotated[
        str | None,
        typer.Option(
            help="Time zone of times that are text without one: UTC, +02:00, Europe/Berlin."
        ),
    ] = None,
    tolerance: Annotated[
        float,
        typer.Option(help="Largest difference between an archiver's time stamps of one tick [s]."),
    ] = 0.01,
    hold: Annotated[
        float | None,
        typer.Option(
            help="Longest time for which an archived setpoint counts without a new sample [s] "
            "[until its connection was lost]."
        ),
    ] = None,
    period: Annotated[
        float | None, typer.Option(help="Time from one tick to the next [s] [the median].")
    ] = None,
    anyway: Anyway = False,
    config_file: ConfigFile = None,
    planes: Planes = None,
    places: PlacesTable = None,
    ring: RingParameters = None,
    as_json: AsJson = False,
) -> None:
    """Import an orbit history, as a record for `orbitfb diagnose`."""
    from orbitfb.core.errors import ConfigError
    from orbitfb.exchange.orbits.history import write_history
    from orbitfb.exchange.orbits.reading import HistoryRequest, read_history

    for option, value in (("tolerance", tolerance), ("hold", hold), ("period", period)):
        if value is not None and not 0 < value < 1e9:
            raise ConfigError(f"--{option} {value:g}: give seconds above 0")
    settings = configure(
        config_file, ring__planes=planes, ring__places=places, ring__parameters=ring
    )
    loaded = settings.ring.load()
    channels = loaded.channels(settings.ring.planes)
    request = HistoryRequest(
        tuple(files), time, orbit, setpoints, bpm_names, corrector_names, order, time_unit,
        orbit_unit, setpoint_unit, time_zone, tolerance, hold,
    )  # fmt: skip
    slow = {name: (each.pv, each.scale) for name, each in settings.epics.auxiliary.items()}
    history, noticed = read_history(request, channels, slow)
    show(noticed | write_history(history, loaded, channels, out, period, anyway), as_json)


@importing.command("lattice")
@tells_its_time("reading the lattice")
def import_lattice_command(
    file: Annotated[Path, typer.Argument(help="Lattice that pyAT reads: .m, .mat or .json.")],
    calibration: Annotated[
        float, typer.Option(help="Kick per ampere of every corrector [rad/A]; no lattice says it.")
    ],
    calibration_y: Annotated[
        float | None, typer.Option(help="The same in the vertical plane [as --calibration].")
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="File for `ring.places` (CSV).")] = Path(
        "places.csv"
    ),
    parameters: Annotated[Path, typer.Option(help="File for `ring.parameters` (JSON).")] = Path(
        "ring.json"
    ),
    bpms: Annotated[
        str | None, typer.Option(help="Families of BPMs, with * and ? [all monitors].")
    ] = None,
    correctors: Annotated[
        str | None, typer.Option(help="Families of correctors [all of class Corrector].")
    ] = None,
    names: Annotated[
        str | None,
        typer.Option(help="Attribute with the name of each element [its family, numbered]."),
    ] = None,
    variable: Annotated[
        str | None, typer.Option(help="Which of several lattices in the file [the only one].")
    ] = None,
    harmonic: Annotated[
        int | None, typer.Option(min=1, help="RF periods per turn [of the cavities].")
    ] = None,
    bpm_pv: Annotated[
        str, typer.Option(help="Form of PV names: {name}, {plane} (x), {PLANE} (X).")
    ] = "{name}:{PLANE}",
    setpoint_pv: Annotated[str, typer.Option(help="The same of setpoints.")] = "{name}:{PLANE}:SP",
    readback_pv: Annotated[str, typer.Option(help="The same of readbacks.")] = "{name}:{PLANE}:RB",
    as_json: AsJson = False,
) -> None:
    """Make a table of places and ring parameters of a lattice (takes the extra `lattice`)."""
    from orbitfb.exchange.lattice.table import LatticeRequest, import_lattice

    kicks = (calibration, calibration if calibration_y is None else calibration_y)
    request = LatticeRequest(
        file, kicks, out, parameters, bpms, correctors, names, variable, harmonic, bpm_pv,
        setpoint_pv, readback_pv,
    )  # fmt: skip
    show(import_lattice(request), as_json)

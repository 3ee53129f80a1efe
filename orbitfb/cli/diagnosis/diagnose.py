"""The command that diagnoses a record."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orbitfb.cli.diagnosis.progress import progress_bar, told_when_interrupted
from orbitfb.cli.duration import tells_its_time
from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    PlacesTable,
    RecordPlanes,
    RingParameters,
    configure,
    path_of,
    planes_of,
)
from orbitfb.cli.record_first import DEFAULT, RecordFirst

if TYPE_CHECKING:
    from orbitfb.diagnose.result.diagnosis import Diagnosis
    from orbitfb.physics.places import Ring

NOT_INTACT = 3
"""Exit code when the record failed the integrity screen."""
_UNBROKEN = 10_000
"""Width of lines that are no terminal's: a file or a program wants a row in one line."""

diagnose = typer.Typer(
    cls=RecordFirst,
    help="Find where simulator and machine differ, which effect is the cause, and how much of "
    "the difference it explains. `orbitfb diagnose RECORD` is short for `orbitfb diagnose "
    "record RECORD`. If a file has the name of a command, write ./NAME.",
    no_args_is_help=True,
    subcommand_metavar="RECORD [OPTIONS] | COMMAND [ARGS]",
)


@diagnose.command(DEFAULT)
@tells_its_time("the diagnosis")
def diagnose_record(
    record: Annotated[
        Path,
        typer.Argument(
            help="Record in question: an archive or a segment of it, an .npz or an HDF5 file; or a "
            "measured response (.safetensors, .mat, .csv, .npy, .npz, .json, HDF5)."
        ),
    ],
    reference: Annotated[
        Path | None,
        typer.Option(help="Record of the healthy ring; noise and drift are taken from it."),
    ] = None,
    holdout: Annotated[
        Path | None,
        typer.Option(help="Later record, on which the causes are tested [the record itself]."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            parser=path_of,
            metavar="PATH",
            help="Directory for diagnosis.json, report.html and effect.toml [beside the record, "
            "NAME.diagnosis].",
        ),
    ] = None,
    planes: RecordPlanes = None,
    places: PlacesTable = None,
    ring: RingParameters = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the random numbers behind the intervals.")
    ] = 0,
    without: Annotated[
        list[str] | None,
        typer.Option(help="Id of an effect to leave out; repeatable."),
    ] = None,
    unit: Annotated[
        str | None,
        typer.Option(help="Unit of a measured response: m/A, mm/A, mm/mrad, … [that in the file]."),
    ] = None,
    matrix: Annotated[
        str | None, typer.Option(help="Path of a measured response within its file.")
    ] = None,
    bpm_names: Annotated[
        str | None,
        typer.Option(help="Names of the BPMs of a response: a path in its file, or @FILE."),
    ] = None,
    corrector_names: Annotated[
        str | None, typer.Option(help="Names of its correctors, in the same way.")
    ] = None,
    transpose: Annotated[
        bool, typer.Option("--transpose", help="The rows of the response are correctors.")
    ] = False,
    noise: Annotated[
        str | None,
        typer.Option(
            help="Noise of an orbit change in a measured response, for example 0.5um [that in "
            "the file, or the residual of the fit]."
        ),
    ] = None,
    kick: Annotated[
        str, typer.Option(help="Kick that made this change, for example 100urad.")
    ] = "100urad",
    dispersion: Annotated[
        Path | None,
        typer.Option(
            parser=path_of,
            metavar="PATH",
            help="Table of the measured horizontal dispersion, with the columns `bpm,dispersion "
            "[m]` [that in the file of the response, if any].",
        ),
    ] = None,
    mask: Annotated[
        list[str] | None,
        typer.Option(
            help="BPM or corrector of a measured response to leave out, NAME or NAME:x; repeatable."
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option(
            parser=path_of,
            metavar="PATH",
            help="Response of another program to compare the measured one with, in any of the "
            "same formats [that of the places table].",
        ),
    ] = None,
    config_file: ConfigFile = None,
    as_json: AsJson = False,
) -> None:
    """Diagnose a record, or a measured response.

    Exit code 0: answered; 3: the record is not intact; 2: any other error.
    """
    from orbitfb.cli.diagnosis.response import ResponseOptions, diagnose_response, is_response
    from orbitfb.diagnose.report.writing import check_directory, write
    from orbitfb.diagnose.result.diagnosis import document
    from orbitfb.diagnose.verdict.files import diagnose_files
    from orbitfb.effects.registry import effect

    chosen = planes_of(planes)
    left_out = frozenset(effect(name).id for name in without or ())
    target = out or beside(record)
    check_directory(target)
    of_response = ResponseOptions(
        unit, matrix, bpm_names, corrector_names, transpose, noise, kick, dispersion,
        tuple(mask or ()), model,
    )  # fmt: skip
    if of_response.given or is_response(record):
        diagnose_response(record, of_response, chosen, places, ring, target, as_json, config_file)
        return
    known = _ring_of(config_file, places, ring)
    with told_when_interrupted():
        with progress_bar(as_json) as progress:
            answer = diagnose_files(
                record,
                reference,
                holdout,
                planes=chosen,
                ring=known,
                seed=seed,
                without=left_out,
                progress=progress,
            )
        written = write(answer, target)
    if as_json:
        print(document(answer), end="")
    else:
        _show(answer, written)
    if answer.failed:
        raise typer.Exit(NOT_INTACT)


def _ring_of(config: Path | None, places: Path | None, ring: Path | None) -> "Ring":
    from orbitfb.physics.places import Ring

    if config is None:
        return Ring.load(places, ring)
    return configure(config, ring__places=places, ring__parameters=ring).ring.load()


def beside(record: Path) -> Path:
    """Name the directory for a diagnosis whose place was not chosen."""
    whole = record.resolve()
    name = whole.name if whole.is_dir() else whole.stem
    return whole.with_name(f"{name}.diagnosis")


def _show(answer: "Diagnosis", written: tuple[Path, ...]) -> None:
    """Print the answer, what is wrong with the record, and what to do, as plain text."""
    from rich.console import Console
    from rich.text import Text

    from orbitfb.diagnose.result.headline import describe, to_do
    from orbitfb.diagnose.result.quantities import quantity

    console = Console()
    if not console.is_terminal:
        console.width = _UNBROKEN

    def say(text: str) -> None:
        # what a record brought must move no cursor
        shown = "".join(sign for sign in text if sign.isprintable())
        console.print(Text(shown), soft_wrap=True)

    say(f"{answer.state or 'not intact'}: {answer.headline}")
    for finding in answer.findings:
        if finding.severity != "note":
            say(f"{finding.severity}: {finding.text}")
    for number, cause in enumerate(answer.causes):
        say(f"cause: {describe(cause)} ({cause.effect})")
        if number:  # the headline says it of the first one
            say(f"  {to_do(cause)}")
        if cause.alternatives:
            say(f"  It may also be {', '.join(cause.alternatives)}.")
    shrink = answer.shrink
    if shrink is not None and shrink.resolved and shrink.before_um is not None:
        before = quantity(1e-6 * shrink.before_um, "m")
        after = quantity(1e-6 * (shrink.after_um or 0.0), "m")
        say(f"prediction error in addition to noise: {before}, with the causes {after}")
    if answer.experiment is not None:
        say(f"experiment: {answer.experiment.text}")
    for path in written:
        say(f"written: {path}")

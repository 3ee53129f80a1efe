"""The command that plans the experiment that a record asks for."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import (
    AsJson,
    PlacesTable,
    RecordPlanes,
    RingParameters,
    path_of,
    planes_of,
)


def diagnose_plan(
    record: Annotated[
        Path,
        typer.Argument(help="Record that cannot decide between effects, or shows them too weakly."),
    ],
    out: Annotated[
        Path,
        typer.Option(
            parser=path_of,
            metavar="PATH",
            help="File for `orbitfb run --excite`: a description (TOML), or a waveform (.npz).",
        ),
    ],
    wanted: Annotated[
        str | None,
        typer.Option("--for", help="Id of the effect to see better [the most likely one]."),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(help="Id of the effect to tell it from [no effect]."),
    ] = None,
    orbit_limit: Annotated[
        float | None,
        typer.Option(
            min=1e-3, help="Largest rms orbit of the excitation [µm] [10 in x and 1 in y]."
        ),
    ] = None,
    minutes: Annotated[float, typer.Option(min=0.1, max=600.0, help="Beam time [min].")] = 10.0,
    planes: RecordPlanes = None,
    places: PlacesTable = None,
    ring: RingParameters = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of random levels.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Plan the experiment that tells effects apart, within limits of orbit, current and time.

    Without --for, the plan tells the two most likely effects apart. Exit code 3: the
    record is not intact, and nothing is written.
    """
    from orbitfb.cli.diagnosis.diagnose import NOT_INTACT
    from orbitfb.cli.diagnosis.progress import progress_bar, told_when_interrupted
    from orbitfb.core.errors import ConfigError
    from orbitfb.diagnose.experiments.asked import plan_for
    from orbitfb.diagnose.experiments.file import check_file
    from orbitfb.diagnose.experiments.search import limits_of
    from orbitfb.diagnose.likelihood.workspace import Workspace
    from orbitfb.diagnose.screen.planes import check_planes
    from orbitfb.diagnose.screen.run import is_hopeless, screen
    from orbitfb.effects.registry import all_effects, effect
    from orbitfb.physics.places import Ring
    from orbitfb.records.reading.load import load

    chosen = planes_of(planes)
    check_file(out)
    if against is not None and wanted is None:
        raise ConfigError("--against: needs --for, the effect that is to be told from it")
    kinds = list(all_effects().values()) if wanted is None else [effect(wanted)]
    rival = None if against is None else effect(against)
    if rival in kinds and wanted is not None:
        raise ConfigError(f"--against {against}: it is the effect of --for; name another one")
    read = load(record, planes=chosen, ring=Ring.load(places, ring))
    loaded = read.record
    found = [*read.findings, *screen(loaded)]
    check_planes(chosen, found)
    for finding in found:
        if finding.severity != "note":
            print(f"{finding.severity}: {finding.text}", file=sys.stderr)
    if is_hopeless(found):
        print("the record is not intact: nothing was planned or written", file=sys.stderr)
        raise typer.Exit(NOT_INTACT)
    for kind in (*(kinds if wanted else ()), *((rival,) if rival else ())):
        if reason := kind.unavailable(loaded):
            raise ConfigError(f"{kind.id}: this record cannot show it: {reason}")
    limit = None if orbit_limit is None else orbit_limit * 1e-6
    with told_when_interrupted():
        with progress_bar(as_json) as progress:
            progress("estimating the floor", 0.0)
            able = [kind for kind in all_effects().values() if not kind.unavailable(loaded)]
            planned = plan_for(
                Workspace.of(loaded, able),
                [kind for kind in able if kind in kinds],
                limits_of(limit, minutes),
                rival,
                seed,
                progress,
            )
        if planned.settings is not None:
            planned.write(out)
    experiment = planned.experiment
    if planned.settings is not None:
        experiment = experiment.model_copy(update={"file": str(out)})
    if as_json:
        print(experiment.model_dump_json(indent=1))
        return
    print(experiment.text)
    if experiment.limits:
        print(f"limits: {experiment.limits}")
    print(
        f"run it: orbitfb run --ioc … --excite {out}" if experiment.file else "nothing was written"
    )

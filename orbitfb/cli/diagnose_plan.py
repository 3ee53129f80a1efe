"""The command that plans the experiment that a record asks for."""

from pathlib import Path
from typing import Annotated

import typer

from orbitfb.cli.options import AsJson, PlacesTable, RecordPlanes, RingParameters, planes_of


def diagnose_plan(
    record: Annotated[Path, typer.Argument(help="Record that cannot decide, or shows too little.")],
    out: Annotated[
        Path,
        typer.Option(
            help="File for `orbitfb run --excite`: a description (TOML), or a waveform (.npz)."
        ),
    ],
    wanted: Annotated[
        str | None,
        typer.Option("--for", help="Id of the effect to see better [the best of all]."),
    ] = None,
    against: Annotated[
        str | None,
        typer.Option(help="Id of the effect to tell it from [its being there at all]."),
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

    Without --for all effects compete, and the best two are to be told apart.
    """
    from orbitfb.cli.diagnose import progress_bar
    from orbitfb.core.errors import ConfigError
    from orbitfb.diagnose.bench import Bench
    from orbitfb.diagnose.load import load
    from orbitfb.diagnose.plan import limits_of, plan_for
    from orbitfb.effects.registry import all_effects, effect
    from orbitfb.physics.places import Ring

    chosen = planes_of(planes)
    if against is not None and wanted is None:
        raise ConfigError("--against: needs --for, the effect that is to be told from it")
    kinds = list(all_effects().values()) if wanted is None else [effect(wanted)]
    rival = None if against is None else effect(against)
    loaded = load(record, planes=chosen, ring=Ring.load(places, ring)).record
    for kind in (*(kinds if wanted else ()), *((rival,) if rival else ())):
        if reason := kind.unavailable(loaded):
            raise ConfigError(f"{kind.id}: this record cannot show it: {reason}")
    limit = None if orbit_limit is None else orbit_limit * 1e-6
    with progress_bar(as_json) as progress:
        progress("reading", 0.0)
        chosen = plan_for(
            Bench(loaded),
            [kind for kind in kinds if not kind.unavailable(loaded)],
            limits_of(limit, minutes),
            rival,
            seed,
            progress,
        )
    experiment = chosen.experiment
    if chosen.settings is not None:
        chosen.write(out)
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

"""The command that runs the paper's experiment."""

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from orbitfb.cli.options import validated


def evaluate_paper_command(
    out: Annotated[
        Path,
        typer.Option(
            help="Directory for table.json, table.md, the figures, the page and the result of "
            "every part; the same command there goes on where it was interrupted."
        ),
    ],
    quick: Annotated[
        bool, typer.Option("--quick", help="Scenario E2, 32 trajectories; the default.")
    ] = False,
    full: Annotated[
        bool,
        typer.Option(
            "--full", help="All scenarios and methods, 1000 trajectories where a method is static."
        ),
    ] = False,
    scenario: Annotated[
        list[str] | None,
        typer.Option(
            help="E1, E2, E2h, E2-clean, s1, s2 or s3; may be given again [E2; --full: all]."
        ),
    ] = None,
    method: Annotated[
        list[str] | None,
        typer.Option(
            help="A method by its name in the table; may be given again [the quick ones; --full: "
            "all]."
        ),
    ] = None,
    trajectories: Annotated[
        int | None, typer.Option(min=1, help="Trajectories of every method [32].")
    ] = None,
    steps: Annotated[int | None, typer.Option(help="Length of the drift [ticks].")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of ring errors and trajectories [the frozen one].")
    ] = None,
    plane: Annotated[str | None, typer.Option(help="x or y [x].")] = None,
    workers: Annotated[
        int | None, typer.Option(help="Local processes; 1: this one [one for each core].")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(help="Address of a Dask scheduler whose workers run the parts [local]."),
    ] = None,
    device: Annotated[
        str | None, typer.Option(help="Where networks are trained: auto, cpu or cuda [auto].")
    ] = None,
) -> None:
    """The paper's experiment: table, figures and page, beside the published ones."""
    from orbitfb.core.errors import ConfigError
    from orbitfb.evaluate.paper.methods import METHODS
    from orbitfb.evaluate.paper.report.write import prepare, write
    from orbitfb.evaluate.paper.run import evaluate_paper
    from orbitfb.evaluate.paper.scenarios import NAMES
    from orbitfb.evaluate.paper.settings import MANY, PaperSettings

    if quick and full:
        raise ConfigError("--quick and --full exclude each other: give one of them")
    for option, names, choices in (("scenario", scenario, NAMES), ("method", method, METHODS)):
        for name in names or ():
            if name not in choices:
                raise ConfigError(
                    f"--{option}: there is no {name!r}; choose from {', '.join(choices)}"
                )
    asked: dict[str, Any] = {}
    if full:
        asked = {"scenarios": NAMES, "methods": tuple(METHODS), "static_trajectories": MANY}
    given = {
        "scenarios": scenario,
        "methods": method,
        "trajectories": trajectories,
        "static_trajectories": trajectories,
        "steps": steps,
        "seed": seed,
        "plane": plane,
        "device": device,
    }
    asked |= {name: value for name, value in given.items() if value is not None}
    settings = validated(PaperSettings, asked)
    left_out = [name for name in settings.methods if not METHODS[name].installed]
    for name in left_out:
        extra = METHODS[name].extra
        print(f"{name} is left out: it needs the extra {extra!r}: pip install 'orbitfb[{extra}]'")
    methods = tuple(name for name in settings.methods if name not in left_out)
    settings = validated(PaperSettings, {**settings.model_dump(), "methods": methods})
    prepare(out)
    began = time.monotonic()

    def tell(what: str, done: int, total: int) -> None:
        print(f"{time.monotonic() - began:5.0f} s  {done} of {total} {what} done", flush=True)

    result = evaluate_paper(settings, out / "parts", workers, scheduler, tell)
    write(result, out)
    print((out / "table.md").read_text(encoding="utf-8"))
    print(f"written: {out / 'table.json'}, {out / 'table.md'}, {out / 'index.html'}")

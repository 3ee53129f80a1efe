"""The command that trains."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orbitfb.cli.duration import tells_its_time
from orbitfb.cli.options import (
    AsJson,
    ConfigFile,
    DataDirectory,
    EffectsFile,
    EffectSpecs,
    Planes,
    chosen_effects,
    configure,
    show,
)

if TYPE_CHECKING:
    from orbitfb.app.train.request import Progress


@tells_its_time("the training")
def train(
    method: Annotated[
        str,
        typer.Argument(
            help="svd, modal, network (computed from the response); structured, supervised, "
            "trajectory (trained); forward (a model: the forward net)."
        ),
    ],
    start: Annotated[
        str,
        typer.Option(
            help="Response to begin from: nominal (that of the optics, and what the effects make "
            "of it), or the id of a stored policy."
        ),
    ] = "nominal",
    archive: Annotated[
        Path | None,
        typer.Option(
            "--from", help="Archive to identify the response from; labels of supervised training."
        ),
    ] = None,
    validate: Annotated[
        Path | None,
        typer.Option(help="Archive with another excitation, to validate a forward net on."),
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="Forward net to train a trajectory policy on, not the response."),
    ] = None,
    published: Annotated[
        bool, typer.Option("--published", help="Train as the paper does, not as configured.")
    ] = False,
    warm: Annotated[
        bool, typer.Option("--warm", help="Begin with the weights of the stored policy --start.")
    ] = False,
    iterations: Annotated[
        int | None, typer.Option(help="Iterations [those of the configuration].")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed [that of the configuration].")] = None,
    device: Annotated[str, typer.Option(help="auto, cpu or cuda.")] = "auto",
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Start again instead of continuing an interrupted training."),
    ] = False,
    activate: Annotated[
        bool, typer.Option("--activate", help="Put the policy in force when it is trained.")
    ] = False,
    effect: EffectSpecs = None,
    effects: EffectsFile = None,
    config_file: ConfigFile = None,
    data: DataDirectory = None,
    planes: Planes = None,
    as_json: AsJson = False,
) -> None:
    """Train a policy or a model and store it; after Ctrl-C the same command continues."""
    from orbitfb.app.train.forward_model import train_model
    from orbitfb.app.train.policy import train_policy
    from orbitfb.app.train.request import FORWARD, TrainingRequest

    settings = configure(
        config_file,
        data_directory=data,
        ring__planes=planes,
        effect=chosen_effects(effect, effects),
        effects_file=effects,
    )
    request = TrainingRequest(
        method=method,
        start=start,
        archive=archive,
        validation=validate,
        model=model,
        published=published,
        warm=warm,
        iterations=iterations,
        seed=seed,
        device=device,
        fresh=fresh,
        activate=activate,
    )
    work = train_model if method == FORWARD else train_policy
    with _progress(as_json) as progress:
        try:
            answer = work(settings, request, progress)
        except KeyboardInterrupt:
            print("interrupted: the same command goes on from here, --fresh starts again")
            raise typer.Exit(130) from None
    show(answer, as_json)


@contextmanager
def _progress(quiet: bool) -> "Generator[Progress, None, None]":
    """Draw a bar on standard error, if that is a terminal, while a training runs."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("training"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("loss {task.fields[loss]:.3g}"),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    off = quiet or not console.is_terminal  # elsewhere it would leave an empty line
    with Progress(*columns, console=console, transient=True, disable=off) as bar:
        task = bar.add_task("training", total=None, loss=float("nan"), visible=False)

        def progress(done: int, total: int, loss: float) -> None:
            bar.update(task, completed=done, total=total, loss=loss, visible=True)

        yield progress

"""What is shown on standard error while a diagnosis runs, and what an interrupted one says."""

import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from orbitfb.diagnose.progress import Progress

INTERRUPTED = 130
"""Exit code after ctrl-C, as shells have it."""


@contextmanager
def told_when_interrupted() -> Generator[None, None, None]:
    """Say that what ctrl-C ended has written nothing."""
    try:
        yield
    except KeyboardInterrupt:
        print("orbitfb: interrupted; nothing was written", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None


@contextmanager
def progress_bar(quiet: bool) -> "Generator[Progress, None, None]":
    """Draw a bar on standard error while a diagnosis runs."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

    columns = (
        TextColumn("{task.description:<14}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True)
    # A bar that is no terminal's is an empty line before whatever is said next.
    hidden = quiet or not console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=hidden) as bar:
        task = bar.add_task("reading", total=1.0)

        def progress(what: str, share: float) -> None:
            bar.update(task, description=what, completed=share)

        yield progress

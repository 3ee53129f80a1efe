"""The program `orbitfb`: all commands together, and how a known error ends it."""

import errno
import io
import sys
from typing import Annotated

import typer

from orbitfb import __version__
from orbitfb.cli.config import config
from orbitfb.cli.diagnosis.diagnose import diagnose
from orbitfb.cli.diagnosis.plan import diagnose_plan
from orbitfb.cli.doctor import doctor
from orbitfb.cli.effects import effects
from orbitfb.cli.evaluation.agent import evaluate_agent_command
from orbitfb.cli.evaluation.evaluate import evaluate
from orbitfb.cli.evaluation.kick import evaluate_kick_command
from orbitfb.cli.exporting import exporting
from orbitfb.cli.health import health
from orbitfb.cli.importing import importing
from orbitfb.cli.measure import measure_response_command
from orbitfb.cli.policies import policies
from orbitfb.cli.postmortem import postmortem
from orbitfb.cli.service import command, ioc, refit, run
from orbitfb.cli.train import train
from orbitfb.core.errors import OrbitFeedbackError

app = typer.Typer(
    name="orbitfb",
    help="Adaptive orbit feedback for synchrotron light sources on an EPICS control network.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _function in (run, ioc, train, refit, command, health, postmortem):
    app.command()(_function)
app.command()(doctor)
app.command("measure-response")(measure_response_command)
evaluate.command("kick")(evaluate_kick_command)
evaluate.command("agent")(evaluate_agent_command)
app.add_typer(policies, name="policies")
app.add_typer(evaluate, name="evaluate")
diagnose.command("plan")(diagnose_plan)
app.add_typer(diagnose, name="diagnose")
app.add_typer(effects, name="effects")
app.add_typer(importing, name="import")
app.add_typer(exporting, name="export")
app.add_typer(config, name="config")

_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""What writing says where there is no room."""


def main() -> None:
    """Run the command line; an error that is known is printed without a traceback, exit code 2."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that knows no µ gets a ?
    try:
        try:
            app()
        finally:
            sys.stdout.flush()
        return
    except OrbitFeedbackError as error:
        told = str(error)
    except OSError as error:
        if error.errno not in _FULL:
            raise
        sys.stdout = None  # what is left of the output cannot be written at the end either
        told = f"the output cannot be written ({error.strerror}); make room, or write it elsewhere"
    except MemoryError:
        told = (
            "there is not enough memory; raise the limit (ulimit -v, of the container, MemoryMax), "
            "or give a shorter record"
        )
    print(f"orbitfb: {told}", file=sys.stderr)
    sys.exit(2)


def _version(wanted: bool) -> None:
    if wanted:
        print(__version__)
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print the version.", callback=_version, is_eager=True),
    ] = False,
) -> None:
    """Take the options that stand before any command."""

"""The data directory of a service: owned by one, with the log in it."""

import tempfile
from contextlib import ExitStack
from pathlib import Path

from orbitfb.app.service.access import RingAccess
from orbitfb.app.setup.startup import make_directory
from orbitfb.config.tree import AppConfig
from orbitfb.core.files.ownership import Lock
from orbitfb.measure.left import DIRECTORY
from orbitfb.observe.logs import configure_logs


def take_directory(config: AppConfig, stack: ExitStack) -> None:
    """Make the data directory, own it, and begin the log.

    Args:
        config: The configuration.
        stack: Lets go of it.

    Raises:
        OrbitFeedbackError: It cannot be made, or another service owns it.
    """
    directory = config.data_directory
    make_directory(directory)
    stack.enter_context(
        Lock(
            f"data {directory.resolve()}",
            f"the data directory {directory}",
            "stop it, or name another directory with --data",
        )
    )
    logs = configure_logs(config.observe.logs, directory)
    stack.callback(logs.close)


def journal_of(directory: Path, access: RingAccess, stack: ExitStack) -> Path:
    """Say where a measurement keeps its journal: that of a simulated ring ends with it.

    Args:
        directory: The data directory.
        access: The ring as the service reaches it.
        stack: Removes a temporary one.
    """
    if access.own is None:
        return directory / DIRECTORY
    return Path(stack.enter_context(tempfile.TemporaryDirectory()))

"""The page as a child process: one line of JSON in, READY out, until the parent is gone."""

import asyncio
import os
import signal
import sys

from pydantic import ValidationError

from orbitfb.core.errors import ConfigError, OrbitFeedbackError, OwnershipError
from orbitfb.page.job import PageJob
from orbitfb.sim.job import PORT_TAKEN
from orbitfb.sim.process import stop_with_parent

NICENESS = 10
"""The loop comes first."""


def main() -> int:
    """Serve the job on standard input until it ends, or until SIGTERM or SIGINT.

    Returns:
        2 if the job cannot be done, 3 if somebody else has the port; the reason is on standard
        error. After a clean stop 0.
    """
    os.nice(NICENESS)
    try:
        asyncio.run(_run(_read_job()))
    except OrbitFeedbackError as error:
        sys.stderr.write(f"{error}\n")
        return PORT_TAKEN if isinstance(error, OwnershipError) else 2
    return 0


def _read_job() -> PageJob:
    try:
        return PageJob.model_validate_json(sys.stdin.buffer.readline())
    except ValidationError as error:
        raise ConfigError(f"the job on standard input is wrong: {error}") from error


async def _run(job: PageJob) -> None:
    from orbitfb.page.server import serve

    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    stop_with_parent(loop, stop, sys.stdin.fileno())
    await serve(job, _announce, stop)
    # a question to a service that hangs may still wait for its answer; nothing is left to save
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _announce(port: int, _bpms: int) -> None:
    sys.stdout.write(f"READY port={port} pvs=0\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())

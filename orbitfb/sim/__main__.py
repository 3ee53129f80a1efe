"""The soft IOC as a process: one line of JSON in, READY out, until the parent is gone."""

import asyncio
import contextlib
import gc
import logging
import os
import signal
import sys

from pydantic import ValidationError

from orbitfb.core.errors import ConfigError, OrbitFeedbackError, OwnershipError
from orbitfb.sim.environment import server_environment
from orbitfb.sim.job import PORT_TAKEN, SimJob


def main() -> int:
    """Serve the job on standard input until it ends, or until SIGTERM or SIGINT.

    Returns:
        0 after a clean stop, 2 if the job cannot be done, 3 if somebody else has the port; the
        reason is on standard error.
    """
    try:
        asyncio.run(_serve(_read_job()))
    except OrbitFeedbackError as error:
        sys.stderr.write(f"{error}\n")
        return PORT_TAKEN if isinstance(error, OwnershipError) else 2
    return 0


def _read_job() -> SimJob:
    try:
        return SimJob.model_validate_json(sys.stdin.buffer.readline())
    except ValidationError as error:
        raise ConfigError(f"the job on standard input is wrong: {error}") from error


async def _serve(job: SimJob) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    _stop_with_parent(loop, stop)
    ring, settings = job.build()
    os.environ.update(server_environment(settings.plain))
    from orbitfb.sim.server import serve  # caproto reads the environment when it is imported

    logging.getLogger("caproto").setLevel(logging.CRITICAL)  # a refused write is no accident
    await serve(ring, settings, _announce, stop)
    # caproto's tasks can miss that they are cancelled (asyncio.wait_for before Python 3.12), and
    # asyncio.run would wait for them for ever; nothing is left to save
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def _stop_with_parent(loop: asyncio.AbstractEventLoop, stop: asyncio.Event) -> None:
    """Stop when standard input ends: whoever holds its other end is dead, however it died."""

    def readable() -> None:
        if not os.read(sys.stdin.fileno(), 4096):
            loop.remove_reader(sys.stdin.fileno())
            stop.set()

    # a plain file as standard input has no other end
    with contextlib.suppress(PermissionError):
        loop.add_reader(sys.stdin.fileno(), readable)


def _announce(port: int, pvs: int) -> None:
    gc.freeze()
    sys.stdout.write(f"READY port={port} pvs={pvs}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())

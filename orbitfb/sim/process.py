"""A process that is the soft IOC: from a job to the end of it."""

import asyncio
import contextlib
import gc
import logging
import os
import signal
import sys

from orbitfb.sim.environment import server_environment
from orbitfb.sim.job import SimJob
from orbitfb.sim.served import Announce, Served


def run_job(job: SimJob, announce: Announce, parent: int | None = None) -> None:
    """Serve until SIGTERM or SIGINT, or until the parent is gone; then end the process with 0.

    Args:
        job: What to serve.
        announce: Told where it is found once clients can connect.
        parent: File descriptor that ends when the parent does; None: there is no such parent.

    Raises:
        OwnershipError: Somebody else has the port.
        RingError: The ring of the job is wrong.
    """
    asyncio.run(_serve(job, announce, parent))


async def _serve(job: SimJob, announce: Announce, parent: int | None) -> None:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    if parent is not None:
        stop_with_parent(loop, stop, parent)
    ring, settings = job.build()
    os.environ.update(server_environment(settings.plain))
    from orbitfb.sim.server import serve  # caproto reads the environment when it is imported

    logging.getLogger("caproto").setLevel(logging.CRITICAL)  # a refused write is no accident

    def ready(served: Served) -> None:
        gc.freeze()
        announce(served)

    await serve(ring, settings, ready, stop)
    # caproto's tasks can miss that they are cancelled (asyncio.wait_for before Python 3.12), and
    # asyncio.run would wait for them for ever; nothing is left to save
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def stop_with_parent(loop: asyncio.AbstractEventLoop, stop: asyncio.Event, parent: int) -> None:
    """Stop when the descriptor ends: whoever holds its other end is dead, however it died."""

    def readable() -> None:
        if not os.read(parent, 4096):
            loop.remove_reader(parent)
            stop.set()

    # a plain file has no other end
    with contextlib.suppress(PermissionError):
        loop.add_reader(parent, readable)

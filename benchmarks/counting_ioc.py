"""Our soft IOC around a counting ring: `python -m benchmarks.counting_ioc SIZE < JOB`."""

import asyncio
import gc
import logging
import os
import signal
import sys

from benchmarks.rings import build_ring
from orbitfb.sim.environment import server_environment
from orbitfb.sim.job import SimJob
from orbitfb.sim.served import Served


async def _serve(job: SimJob, size: int) -> None:
    stop = asyncio.Event()
    asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, stop.set)
    ring, settings = build_ring(job, size)
    os.environ.update(server_environment(settings.plain))
    from orbitfb.sim.server import serve  # caproto reads the environment when it is imported

    logging.getLogger("caproto").setLevel(logging.CRITICAL)
    await serve(ring, settings, _announce, stop)
    os._exit(0)


def _announce(served: Served) -> None:
    gc.freeze()
    sys.stdout.write(f"READY port={served.port} pvs={served.pvs}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    job = SimJob.model_validate_json(sys.stdin.buffer.readline())
    asyncio.run(_serve(job, int(sys.argv[1])))

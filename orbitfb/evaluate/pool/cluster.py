"""Tasks on a Dask cluster. The extra `cluster` brings what this needs."""

import socket
from collections.abc import Iterator, Sequence
from typing import Any

from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.pool.task import Outcome, Task, execute, source

_PATIENCE = 30.0
"""How long to wait for the scheduler, and for its first worker [s]."""

_TO_CONNECT = 5.0
"""How long something may take to answer at the scheduler's address [s]."""


def run_cluster(tasks: Sequence[Task], scheduler: str) -> Iterator[tuple[Task, Outcome]]:
    """Run tasks on the workers of a Dask scheduler.

    Dask runs the task of a worker that died on another one. A result that arrives is fetched at
    once, so that it does not depend on its worker any more.

    Args:
        tasks: What to run.
        scheduler: Address of the scheduler, such as `tcp://10.0.0.5:8786`.

    Yields:
        Every task once, with what came of it, as it comes.

    Raises:
        ConfigError: Dask is not installed, or there is no scheduler, or no worker.
    """
    try:
        import distributed
    except ImportError as error:
        raise ConfigError(
            f"--scheduler {scheduler} needs Dask ({error}): pip install 'orbitfb[cluster]'"
        ) from error
    with _connected(distributed, scheduler) as client:
        futures = {
            client.submit(
                execute,
                task.function,
                dict(task.arguments),
                source(task.function),
                key=f"orbitfb-{task.key}",
            ): task
            for task in tasks
        }
        for future in distributed.as_completed(list(futures), loop=client.loop):
            task = futures.pop(future)
            yield task, _outcome(future)
            future.release()


def _connected(distributed: Any, scheduler: str) -> Any:
    _probe(scheduler)
    try:
        client = distributed.Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"no Dask scheduler at {scheduler}: {error}; start one with `dask scheduler`"
        ) from error
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        client.close()
        raise ConfigError(
            f"the Dask scheduler at {scheduler} has had no worker for {_PATIENCE:g} s; start some "
            f"with `dask worker {scheduler} --nthreads 1`"
        ) from error
    return client


def _probe(scheduler: str) -> None:
    """Refuse an address where nothing listens; Dask's client would try for half a minute."""
    host, _, port = scheduler.rpartition("://")[2].rstrip("/").rpartition(":")
    if not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ConfigError(
            f"--scheduler {scheduler} is no address of a Dask scheduler; give tcp://HOST:PORT"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), _TO_CONNECT).close()
    except (OSError, UnicodeError) as error:
        raise ConfigError(
            f"no Dask scheduler at {scheduler}: {error}; start one with `dask scheduler`"
        ) from error


def _outcome(future: Any) -> Outcome:
    error = future.exception()
    if error is None:
        return Outcome(*future.result())
    return Outcome(error=f"{type(error).__name__}: {error}")

"""Many independent tasks: on the local cores or on a Dask cluster, resumable.

Every result is published under the key of its task, which is made of the function, its arguments
and the source, as soon as it is there. So a campaign that was interrupted goes on where it was,
and the death of a worker costs the task it had, which is run again: nothing is lost and nothing is
counted twice.
"""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from orbitfb.core.errors import CampaignError, ConfigError
from orbitfb.evaluate.pool.cluster import run_cluster
from orbitfb.evaluate.pool.local import cores, run_local
from orbitfb.evaluate.pool.shelf import Shelf
from orbitfb.evaluate.pool.task import Outcome, Task, execute

Progress = Callable[[int, int], None]
"""Told how many tasks are done, of how many."""


def run_tasks(
    tasks: Sequence[Task],
    directory: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = lambda done, total: None,
) -> list[dict[str, Any]]:
    """Run tasks, each one once, and give their results in the order of the tasks.

    Args:
        tasks: What to run; equal ones are run once and have one result.
        directory: Where results are kept and found again; None: in memory alone.
        workers: Local processes; 1: this process; None: one for each core.
        scheduler: Address of a Dask scheduler; None: local.
        progress: Told at the start and after every task.

    Raises:
        CampaignError: Tasks failed. The other ones were run, their results are kept.
        ConfigError: The number of workers is not positive, or the cluster cannot be used.
    """
    wanted = cores() if workers is None else workers
    if wanted < 1:
        raise ConfigError(f"--workers is {workers}; at least one is needed")
    shelf = None if directory is None else Shelf(directory)
    keys = [task.key for task in tasks]
    distinct = dict(zip(keys, tasks, strict=True))
    found = {
        key: outcome
        for key, task in distinct.items()
        if shelf is not None and (outcome := shelf.find(task)) is not None
    }
    missing = [task for key, task in distinct.items() if key not in found]
    progress(len(found), len(distinct))
    for task, outcome in _run(missing, wanted, scheduler):
        if shelf is not None and not outcome.error:
            shelf.publish(task, outcome)
        found[task.key] = outcome
        progress(len(found), len(distinct))
    failed = [(task, found[key]) for key, task in distinct.items() if found[key].error]
    if failed:
        raise CampaignError(
            [(str(task), outcome.error, outcome.trace) for task, outcome in failed],
            [None if found[key].error else found[key].result() for key in keys],
        )
    return [found[key].result() for key in keys]


def _run(
    tasks: Sequence[Task], workers: int, scheduler: str | None
) -> Iterator[tuple[Task, Outcome]]:
    if not tasks:
        return
    if scheduler is not None:
        yield from run_cluster(tasks, scheduler)
    elif workers > 1:
        yield from run_local(tasks, workers)
    else:
        for task in tasks:
            yield task, execute(task.function, task.arguments)

"""Campaigns over real processes, some of which are killed midway."""

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest

from orbitfb.core.errors import CampaignError
from orbitfb.evaluate.campaign import run_tasks
from orbitfb.evaluate.pool.task import Task

UNIT = Path(__file__).parents[1] / "unit" / "evaluate"
PATIENCE = 60.0

pytestmark = [pytest.mark.system, pytest.mark.usefixtures("importable")]


@pytest.fixture
def importable(monkeypatch):
    monkeypatch.syspath_prepend(str(UNIT))


def tasks(function, numbers, **common):
    return [Task(f"campaign_tasks:{function}", {"number": n, **common}) for n in numbers]


def wait_for(condition):
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)
    return found


def lines(path):
    return path.read_text().splitlines() if path.exists() else []


def test_a_worker_killed_midway_costs_nothing(tmp_path):
    results = run_tasks(
        tasks("die_once", range(5), marks=str(tmp_path)), tmp_path / "results", workers=2
    )
    assert [result["square"] for result in results] == [0, 1, 4, 9, 16]
    assert os.getpid() not in {result["pid"] for result in results}
    assert sorted(lines(tmp_path / "log")) == ["0", "1", "2", "3", "4"]
    assert len(list((tmp_path / "results").glob("*.json"))) == 5


def test_a_task_that_kills_every_worker_is_given_up_and_named(tmp_path):
    with pytest.raises(CampaignError, match=r'"number": 1}: given up .* 3 .* signal 9') as caught:
        run_tasks(tasks("always_die", range(3)), tmp_path, workers=2)
    assert caught.value.results == ({"number": 0}, None, {"number": 2})


def test_failures_prints_and_arrays_come_through_the_pipes():
    with pytest.raises(CampaignError, match="three is not wanted"):
        run_tasks(tasks("fail", range(4)), workers=2)
    assert [found["number"] for found in run_tasks(tasks("shout", range(4)), workers=2)] == [
        0, 1, 2, 3,
    ]  # fmt: skip
    seeds = [Task("campaign_tasks:spread", {"seed": seed}) for seed in (1, 2)]
    for here, there in zip(run_tasks(seeds, workers=1), run_tasks(seeds, workers=2), strict=True):
        assert (here["drawn"] == there["drawn"]).all()


@pytest.mark.nightly
def test_a_campaign_killed_midway_goes_on_where_it_was(tmp_path):
    """The workers of a campaign that was killed end in the middle of their tasks."""
    wanted = tasks("slow", range(6), marks=str(tmp_path), seconds=0.5)
    code = (
        "import json, sys; from pathlib import Path\n"
        "from orbitfb.evaluate.campaign import run_tasks\n"
        "from orbitfb.evaluate.pool.task import Task\n"
        "tasks = [Task(f, a) for f, a in json.loads(sys.argv[1])]\n"
        "run_tasks(tasks, Path(sys.argv[2]), workers=2)\n"
    )
    listed = json.dumps([[task.function, dict(task.arguments)] for task in wanted])
    campaign = subprocess.Popen(
        [sys.executable, "-c", code, listed, str(tmp_path / "results")],
        env={**os.environ, "PYTHONPATH": str(UNIT)},
    )
    done = tmp_path / "results"
    wait_for(lambda: len(list(done.glob("*.json"))) >= 2 and len(lines(tmp_path / "began")) >= 3)
    campaign.kill()
    campaign.wait()
    workers = {int(line.split()[1]) for line in lines(tmp_path / "began")}
    wait_for(lambda: not any(psutil.pid_exists(pid) for pid in workers))
    kept = len(list(done.glob("*.json")))
    before = Counter(lines(tmp_path / "log"))
    assert 2 <= kept < 6
    results = run_tasks(wanted, done, workers=2)
    assert [result["number"] for result in results] == list(range(6))
    run_anew = Counter(lines(tmp_path / "log")) - before
    assert sum(run_anew.values()) == 6 - kept
    assert len(list(done.glob("*.json"))) == 6


def start_scheduler(stack, directory):
    """Start a Dask scheduler on a free port; give it and its address."""
    file = directory / "scheduler.json"
    process = stack.enter_context(
        ended(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0",
            "--no-dashboard", "--dashboard-address", "127.0.0.1:0", "--scheduler-file", str(file),
            directory=directory,
        )
    )  # fmt: skip
    wait_for(lambda: file.exists() and file.read_text().endswith("}"))
    return process, json.loads(file.read_text())["address"]


class ended:  # noqa: N801 - reads as a word
    """A Dask program that is gone at the end."""

    def __init__(self, module, *arguments, directory):
        self.log = directory / f"{module.rpartition('.')[2]}-{time.monotonic_ns()}.log"
        with self.log.open("w") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                cwd=directory,
                stdout=log,
                stderr=log,
                env={
                    **os.environ,
                    "PYTHONPATH": str(UNIT),
                    "OMP_NUM_THREADS": "1",
                    "DASK_TEMPORARY_DIRECTORY": str(directory),
                    "DASK_CONFIG": str(directory / "no-dask-config"),
                    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__GIL__ENABLED": "False",
                },
            )

    def __enter__(self):
        return self.process

    def __exit__(self, *error):
        self.process.terminate()
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


def worker(stack, address, directory):
    return stack.enter_context(
        ended(
            "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny",
            "--no-dashboard", "--dashboard-address", "127.0.0.1:0", "--host", "127.0.0.1",
            "--local-directory", str(directory / "spill"),
            directory=directory,
        )
    )  # fmt: skip


@pytest.mark.nightly
@pytest.mark.timeout(180)
def test_on_dask_a_worker_killed_midway_costs_nothing(tmp_path):
    """The asker is a process of its own: Dask leaves threads in it, by design."""
    wanted = tasks("slow", range(8), marks=str(tmp_path), seconds=0.4)
    listed = json.dumps([[task.function, dict(task.arguments)] for task in wanted])
    code = (
        "import json, sys; from pathlib import Path\n"
        "from orbitfb.evaluate.campaign import run_tasks\n"
        "from orbitfb.evaluate.pool.task import Task\n"
        "if __name__ == '__main__':\n"
        "    tasks = [Task(f, a) for f, a in json.loads(sys.argv[1])]\n"
        "    told = []\n"
        "    found = run_tasks(tasks, Path(sys.argv[2]), scheduler=sys.argv[3],\n"
        "                      progress=lambda *seen: told.append(seen))\n"
        "    print(json.dumps([found, told]))\n"
    )
    done = tmp_path / "results"
    with ExitStack() as stack:
        scheduler, address = start_scheduler(stack, tmp_path)
        workers = [worker(stack, address, tmp_path) for _ in range(2)]
        asker = subprocess.Popen(
            [sys.executable, "-W", "error", "-c", code, listed, str(done), address],
            env={**os.environ, "PYTHONPATH": str(UNIT)},
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        stack.enter_context(asker)
        stack.callback(asker.kill)
        victim = workers[0].pid

        def two_began_at_the_victim():
            assert asker.poll() is None, asker.communicate()
            began = [line.split() for line in lines(tmp_path / "began")]
            return sum(int(pid) == victim for _, pid in began) >= 2

        wait_for(two_began_at_the_victim)
        for pid in (asker.pid, *(process.pid for process in (scheduler, *workers))):
            for connection in psutil.Process(pid).net_connections():
                assert connection.laddr.ip == "127.0.0.1"
                assert not connection.raddr or connection.raddr.ip == "127.0.0.1"
        os.kill(victim, signal.SIGKILL)
        said, errors = asker.communicate(timeout=PATIENCE)
        assert asker.returncode == 0, errors
        results, told = json.loads(said)
    assert [result["number"] for result in results] == list(range(8))
    assert told == [[count, 8] for count in range(9)]
    assert len(list(done.glob("*.json"))) == 8
    began = Counter(int(line.split()[0]) for line in lines(tmp_path / "began"))
    assert set(began) == set(range(8))
    assert sum(began.values()) > 8, "nothing was under way in the worker that was killed"
    # What the victim had finished may have been fetched in time, or was done again.
    assert {result["pid"] for result in results} <= {process.pid for process in workers}
    assert results[-1]["pid"] == workers[1].pid


def test_a_scheduler_that_is_not_there_is_said(tmp_path, dead_port):
    code = (
        "from orbitfb.evaluate.campaign import run_tasks\n"
        "from orbitfb.evaluate.pool import cluster\n"
        "from orbitfb.evaluate.pool.task import Task\n"
        "cluster._PATIENCE = 1.0\n"
        f"run_tasks([Task('math:sqrt', {{}})], scheduler='tcp://127.0.0.1:{dead_port}')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert f"no Dask scheduler at tcp://127.0.0.1:{dead_port}" in done.stderr

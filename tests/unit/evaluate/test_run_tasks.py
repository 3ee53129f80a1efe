"""Campaigns in this process: keys, files, resumption, failures."""

import json
import os
import sys
from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.errors import CampaignError, ConfigError
from orbitfb.evaluate.campaign import run_tasks
from orbitfb.evaluate.pool import task as task_module
from orbitfb.evaluate.pool.shelf import Shelf
from orbitfb.evaluate.pool.task import Outcome, Task, encode, execute, source


def tasks(function, *numbers, **common):
    return [Task(f"campaign_tasks:{function}", {"number": n, **common}) for n in numbers]


def lines(path):
    return path.read_text().split() if path.exists() else []


def test_results_come_in_the_order_of_the_tasks_and_progress_is_told():
    told = []
    results = run_tasks(
        tasks("square", 3, 1, 2), workers=1, progress=lambda *seen: told.append(seen)
    )
    assert [result["square"] for result in results] == [9, 1, 4]
    assert all(result["pid"] == os.getpid() for result in results)
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_equal_tasks_are_run_once(tmp_path):
    log = tmp_path / "log"
    results = run_tasks(tasks("square", 5, 5, 6, log=str(log)), workers=1)
    assert [result["number"] for result in results] == [5, 5, 6]
    assert lines(log) == ["5", "6"]


def test_what_was_published_is_not_run_again(tmp_path):
    log, shelf = tmp_path / "log", tmp_path / "results"
    first = run_tasks(tasks("square", 1, 2, log=str(log)), shelf, workers=1)
    again = run_tasks(tasks("square", 3, 2, 1, log=str(log)), shelf, workers=1)
    assert lines(log) == ["1", "2", "3"]
    assert again[1:] == first[::-1]


def test_a_damaged_result_is_run_again(tmp_path):
    log, shelf = tmp_path / "log", tmp_path / "results"
    wanted = tasks("square", 1, log=str(log))
    run_tasks(wanted, shelf, workers=1)
    (shelf / f"{wanted[0].key}.json").write_text('{"result": {"numb')
    assert run_tasks(wanted, shelf, workers=1)[0]["square"] == 1
    assert lines(log) == ["1", "1"]


def test_arrays_before_their_json_are_no_result(tmp_path):
    """As a campaign leaves it that was killed between the two files."""
    task = Task("campaign_tasks:spread", {"seed": 1})
    shelf = Shelf(tmp_path)
    shelf.publish(task, execute(task.function, task.arguments))
    (tmp_path / f"{task.key}.json").unlink()
    assert shelf.find(task) is None


def test_arrays_and_figures_come_back_as_they_were(tmp_path):
    task = Task("campaign_tasks:spread", {"seed": 7})
    expected = np.random.default_rng(7).standard_normal(1000)
    for directory in (None, tmp_path, tmp_path):
        result = run_tasks([task], directory, workers=1)[0]
        np.testing.assert_array_equal(result["drawn"], expected)
        assert result["std"] == expected.std()
        assert result["pair"][0] == 1 and np.isnan(result["pair"][1])
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".npz"]
    document = json.loads((tmp_path / f"{task.key}.json").read_text())
    assert document["arguments"] == {"seed": 7} and document["function"] == task.function


def test_a_failure_is_told_with_its_arguments_and_the_others_are_kept(tmp_path):
    wanted = tasks("fail", 1, 3, 4)
    with pytest.raises(CampaignError, match=r'1 of 3 (.|\n)*"number": 3}: Val') as caught:
        run_tasks(wanted, tmp_path, workers=1)
    assert "three is not wanted" in str(caught.value)
    assert caught.value.results == ({"number": 1}, None, {"number": 4})
    assert len(list(tmp_path.glob("*.json"))) == 2


@pytest.mark.parametrize(
    ("function", "said"),
    [
        ("campaign_tasks:opaque", "arrays must stand at the top"),
        ("campaign_tasks:nothing", "name it `module:function`"),
        ("no_such_module:nothing", "name it `module:function`"),
        ("campaign_tasks", "name it `module:function`"),
    ],
)
def test_what_cannot_be_run_or_written_down_says_so(function, said):
    with pytest.raises(CampaignError, match=said):
        run_tasks([Task(function, {})], workers=1)


def test_a_task_that_exits_is_a_failure():
    with pytest.raises(CampaignError, match="SystemExit: 7"):
        run_tasks(tasks("leave", 7), workers=1)


def test_a_task_must_return_a_mapping():
    with pytest.raises(TypeError, match="mapping, not list"):
        encode([1])


def test_no_tasks_no_results():
    assert run_tasks([], workers=4) == []


def test_no_workers_is_refused():
    with pytest.raises(ConfigError, match="at least one"):
        run_tasks(tasks("square", 1), workers=0)


def test_key_depends_on_function_arguments_and_source(monkeypatch):
    task = Task("campaign_tasks:square", {"number": 1, "log": None})
    assert task.key == Task(task.function, {"log": None, "number": 1}).key
    others = {
        replace(task, arguments={"number": 2, "log": None}).key,
        replace(task, function="campaign_tasks:fail").key,
    }
    task_module._source_of.cache_clear()
    monkeypatch.setattr("orbitfb.__version__", "9.9.9")
    others.add(task.key)
    monkeypatch.undo()
    task_module._source_of.cache_clear()
    assert len(others | {task.key}) == 4


def test_source_covers_the_module_of_the_function():
    assert source("campaign_tasks:square") != source("orbitfb.evaluate.refit:evaluate_refit")


def test_a_worker_with_another_source_refuses():
    outcome = execute("campaign_tasks:square", {"number": 1}, "0" * 64)
    assert "another source" in outcome.error
    same = source("campaign_tasks:square")
    assert not execute("campaign_tasks:square", {"number": 1}, same).error


def test_an_outcome_survives_a_line():
    outcome = execute("campaign_tasks:spread", {"seed": 2})
    line = outcome.to_line()
    assert line.count(b"\n") == 1 and line.endswith(b"\n")
    assert Outcome.from_line(line) == outcome


def test_without_dask_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ConfigError, match=r"orbitfb\[cluster\]"):
        run_tasks(tasks("square", 1), scheduler="tcp://127.0.0.1:1")

"""The JSON at the end of a run."""

import json

import pytest
from observe_records import feed, record, report

from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.refit import Decision
from orbitfb.core.signals import LoopState
from orbitfb.observe.plain import dumps
from orbitfb.observe.statistics.summary import summary, write_summary


def strict(text):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_a_run_without_a_tick_gives_null_not_nan(statistics, tmp_path):
    write_summary(tmp_path / "summary.json", statistics.snapshot())
    found = strict((tmp_path / "summary.json").read_text())
    assert found["orbit_rms_um"] == {"first": None, "last_10s": None, "true_last_10s": None}
    assert found["latency_ms"]["p50"] is None
    assert (found["ticks"], found["state"], found["policy"]) == (0, None, None)


def test_figures_and_units(statistics, clock):
    statistics(record(1, error=(250e-6,) * 4, time=clock.wall() - 100.0))
    feed(statistics, clock, 50, error=(2e-7,) * 4, true=1e-7, latency=1.5e-3)
    statistics(
        record(
            52, time=clock.wall(), state=LoopState.TRIPPED, reason="no beam", lost=True, missed=2
        )
    )
    statistics.refitted(report(Decision.PROMOTED))
    statistics.refitted(report(Decision.REFUSED, 2, gain=float("nan")))
    statistics.refitted(report(Decision.ROLLED_BACK, 3))
    found = summary(statistics.snapshot())
    assert found["orbit_rms_um"]["first"] == pytest.approx(250.0)
    assert found["orbit_rms_um"]["last_10s"] == pytest.approx(0.2)
    assert found["orbit_rms_um"]["true_last_10s"] == pytest.approx(0.1)
    assert found["latency_ms"]["p50"] == pytest.approx(1.5)
    assert (found["ticks"], found["missed_ticks"]) == (52, 2)
    assert (found["state"], found["reason"]) == ("TRIPPED", "no beam")
    assert (found["refits"], found["promotions"], found["refusals"], found["roll_backs"]) == (
        2,
        1,
        1,
        1,
    )
    assert found["swaps"] == 0


def test_writing_replaces_the_file_and_leaves_nothing_beside_it(statistics, tmp_path):
    path = tmp_path / "out" / "summary.json"
    write_summary(path, statistics.snapshot())
    statistics(record(1))
    write_summary(path, statistics.snapshot())
    assert strict(path.read_text())["ticks"] == 1
    assert [file.name for file in path.parent.iterdir()] == ["summary.json"]


def test_a_place_that_cannot_be_written_is_said(statistics, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OrbitFeedbackError, match=r"summary cannot be written to .*summary.json"):
        write_summary(tmp_path / "file" / "summary.json", statistics.snapshot())


def test_values_of_every_kind_become_json():
    import numpy as np

    value = {LoopState.HELD: np.array([1.0, np.nan]), "n": np.int64(3), "b": np.bool_(True)}
    assert strict(dumps(value)) == {"HELD": [1.0, None], "n": 3, "b": True}
    assert strict(dumps({"x": float("-inf"), "d": Decision.PROMOTED, "o": ValueError("no")})) == {
        "x": None,
        "d": "promoted",
        "o": "ValueError('no')",
    }

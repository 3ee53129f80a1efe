"""The benchmark runs, and the page of its figures is what the committed file says."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT))

from benchmarks.measure import first_after, window_figures  # noqa: E402
from benchmarks.page import FIGURES, PAGE, page  # noqa: E402

HEADLINES = {
    "ratio_plain_over_ours_p50",
    "missed_at_100hz",
    "torn_at_100hz",
    "ratio_ours_ioc_over_base_p50",
}


@pytest.mark.system
@pytest.mark.timing
@pytest.mark.nightly
@pytest.mark.timeout(400)
def test_a_rehearsal_measures_every_kind_of_run(tmp_path):
    out = tmp_path / "loop.json"
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.loop", "--quick", "--out", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=380,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    result = json.loads(out.read_text())
    assert set(result) >= HEADLINES
    assert all(isinstance(result[name], int | float) for name in HEADLINES)
    runs = {(row["server"], row["client"]) for row in result["runs"]}
    assert runs == {
        ("ours", "service"),
        ("ours", "ours"),
        ("ours", "plain"),
        ("base", "ours"),
        ("ours-arrays", "ours"),
        ("base-arrays", "ours"),
        ("ours-pva", "ours"),
    }
    for ratio in ("arrays_over_scalars_on_base", "pva_arrays_over_scalars_on_our_ioc"):
        assert result["ratios"][ratio]["lockstep"] > 0.0
    for row in result["runs"] + result["scaling"]:
        assert row["ticks"] > 1 and row["torn"] == 0
        assert row["round_trip_ms"]["count"] == row["ticks"] - 1
        assert len(row["round_trip_ms"]["percents_us"]) == 101
    for row in result["long_runs"] + result["disturbances"]:
        assert row["torn"] == 0
        assert row["ticks"] + row["missed"] >= row["seconds"] * row["rate_hz"]
    policies = {row["disturb"]: row["policies"] for row in result["disturbances"]}
    assert policies["swaps"] == 2
    assert result["about"]["quick"] and len(result["about"]["load_after"]) == 3
    assert "# Performance" in page_of_a_rehearsal(result)


def page_of_a_rehearsal(result):
    """A rehearsal has no fixed rates; the page needs their ratios."""
    for ratios in result["ratios"].values():
        for rate in ("10 Hz", "50 Hz", "100 Hz"):
            ratios.setdefault(rate, None)
    return page(result)


def test_committed_page_is_what_the_figures_say():
    assert PAGE.read_text(encoding="utf-8") == page(json.loads(FIGURES.read_text())), (
        "docs/explanations/performance.md is behind benchmarks/loop.json: "
        "run `.venv/bin/python -m benchmarks.page`"
    )


def test_committed_figures_are_of_a_full_run():
    result = json.loads(FIGURES.read_text())
    assert not result["about"]["quick"]
    assert result["about"]["repeats"] >= 3
    assert all(row["ticks"] > 0 for row in result["runs"])
    assert result["torn_at_100hz"] == sum(row["torn"] for row in result["long_runs"])


def figures(**changes):
    stamps = 100.0 + 0.1 * np.arange(11)
    window = {
        "period": 0.1,
        "stamps": stamps,
        "put_from": stamps + 0.001,
        "put_until": stamps + 0.002,
        "applied": stamps + 0.003,
        "torn": 0,
        "server_cpu": 0.011,
        "client_cpu": 0.022,
    }
    return window_figures(**(window | changes))


def test_round_trip_goes_from_the_orbit_to_the_applied_setpoint():
    found = figures()
    assert found["missed"] == 0 and found["ticks"] == 11
    assert found["round_trip_ms"]["p50"] == pytest.approx(3.0, abs=0.01)
    assert found["latency_ms"]["p50"] == pytest.approx(2.0, abs=0.01)
    assert (found["server_cpu_ms"], found["client_cpu_ms"]) == (1.0, 2.0)


def test_in_lockstep_it_goes_from_orbit_to_orbit():
    found = figures(period=None)
    assert found["missed"] is None
    assert found["round_trip_ms"]["p50"] == pytest.approx(100.0, abs=0.01)


def test_an_orbit_that_never_came_and_one_without_setpoints_are_missed():
    stamps = np.delete(100.0 + 0.1 * np.arange(11), 4)
    until = stamps + 0.002
    until[7] = np.nan
    assert figures(stamps=stamps, put_from=stamps, put_until=until)["missed"] == 2


def test_first_after_finds_the_next_event():
    found = first_after(np.array([3.0, np.nan, 1.0]), np.array([0.5, 1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(found, [1.0, 1.0, 3.0, np.nan])

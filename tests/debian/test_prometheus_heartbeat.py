"""The heartbeat is told at any scrape interval that is allowed, and at none falsely."""

from pathlib import Path

import pytest
from alert_cases import alive
from test_prometheus_rules import group, run_groups

ALERT = "OrbitHeartbeatGone"
TIME = 900
HANGS = 240


def tick_at(seconds: int) -> int:
    """Return when the last tick was that a scrape at this time tells of."""
    return min(seconds, HANGS)


@pytest.mark.parametrize("interval", [5, 15, 30, 60])
@pytest.mark.parametrize("ahead", [-600, 0, 600])
def test_a_loop_that_hangs_is_told_and_one_that_ticks_is_not(
    promtool_program: str, tmp_path: Path, interval: int, ahead: int
):
    scrapes = range(0, TIME, interval)
    ticks, period = " ".join(str(10 * tick_at(at)) for at in scrapes), f"0.1x{TIME}"
    last = " ".join(str(ahead + tick_at(at)) for at in scrapes)
    # A clock that is ahead tells no age: then the count of ticks does, more slowly.
    told = HANGS + (30 if ahead <= 0 else 300) + 30 + 2 * interval + 10
    hangs = group("hangs", ALERT, alive(last, ticks, period), f"{told}s", 1)
    hangs["promql_expr_test"].append(
        {
            "expr": f'ALERTS{{alertname="{ALERT}", alertstate="firing"}}',
            "eval_time": f"{HANGS}s",
            "exp_samples": [],
        }
    )
    lives = alive(
        f"{ahead}+{interval}x{TIME // interval}", f"0+{10 * interval}x{TIME // interval}", period
    )
    ticking = group("ticks", ALERT, lives, f"{TIME - interval}s", 0)
    ticking["promql_expr_test"][0]["expr"] = (
        f'count(count_over_time(ALERTS{{alertname="{ALERT}", alertstate="firing"}}[15m]))'
        " or vector(0)"
    )
    # The age is that at the scrape: it does not grow until the next one.
    worst = "max_over_time(orbitfb:last_tick:age_ratio[10m])"
    ticking["promql_expr_test"].append(
        {
            "expr": f"{worst} > {max(-ahead, 0) / 30 + 0.1}",
            "eval_time": f"{TIME - 1}s",
            "exp_samples": [],
        }
    )
    for test in (hangs, ticking):
        test["interval"] = f"{interval}s"
    assert run_groups(promtool_program, tmp_path, [hangs, ticking]) == ""

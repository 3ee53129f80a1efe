"""Alive and ready: what probes are told in every state."""

import pytest
from observe_records import record

from orbitfb.core.signals import LoopState
from orbitfb.observe.health import health, readiness


@pytest.mark.parametrize(
    ("state", "alive", "ready"),
    [
        (LoopState.OPEN, True, True),
        (LoopState.SHADOW, True, True),
        (LoopState.CLOSED, True, True),
        (LoopState.HELD, True, False),
        (LoopState.TRIPPED, True, False),
        (LoopState.FAULT, False, False),
    ],
)
def test_by_state(statistics, state, alive, ready):
    statistics(record(state=state, reason="beam current 0.0 mA"))
    shot = statistics.snapshot()
    assert health(shot, 5.0).good is alive
    assert readiness(shot, 5.0).good is ready
    if not ready:
        assert readiness(shot, 5.0).body["reason"] == f"{state}: beam current 0.0 mA"


def test_a_loop_that_ticks_no_more_is_neither(statistics, clock):
    statistics(record())
    clock.advance(4.9)
    assert health(statistics.snapshot(), 5.0).good
    clock.advance(0.2)
    for probe in (health, readiness):
        verdict = probe(statistics.snapshot(), 5.0)
        assert not verdict.good
        assert verdict.body["reason"] == "no tick for 5.1 s since the last one"


def test_a_loop_that_starts_is_alive_but_not_ready(statistics, clock):
    clock.advance(1.0)
    assert health(statistics.snapshot(), 5.0).good
    assert readiness(statistics.snapshot(), 5.0).body["reason"] == "no tick yet"
    clock.advance(5.0)
    assert not health(statistics.snapshot(), 5.0).good


def test_what_does_not_work_beside_the_loop_is_told_and_is_no_reason_to_restart(statistics):
    statistics(record(state=LoopState.CLOSED))
    troubles = ("the control socket answers nobody: Too many open files",)
    verdict = health(statistics.snapshot(), 5.0, troubles)
    assert verdict.good and verdict.body["troubles"] == list(troubles)
    assert health(statistics.snapshot(), 5.0).body["troubles"] == []

"""Rows of a ring that does not answer teach nobody; those of one that does are only late."""

import sys
from pathlib import Path

import numpy as np
import pytest

from orbitfb.core.signals import LoopState
from orbitfb.history.buffer import History
from orbitfb.learn.answered import AnsweredRows
from orbitfb.physics.places import Ring

sys.path.append(str(Path(__file__).parents[1] / "loop"))
from lying import closed_loop


@pytest.fixture(scope="module")
def ring():
    return Ring.load()


def bench(ring, **interlocks):
    machine, runner, _, _ = closed_loop(ring, seed=3, **interlocks)
    history = History(machine.channels, 2000)
    runner.subscribe(history)
    return machine, runner, AnsweredRows(history, lambda: runner.believed)


def test_rows_of_a_ring_that_answers_come_late_but_all_come(ring):
    _, runner, rows = bench(ring, answer_after=5.0)
    for _ in range(400):
        runner.step()
    seen = rows.snapshot()
    assert seen.tick[-1] >= 250
    assert seen.usable[60:].all()
    assert len(rows.snapshot(last=50)) == 50
    assert rows.snapshot(since_tick=100).tick[0] == 100


@pytest.mark.parametrize("fault", ["blind", "deaf"])
def test_rows_of_a_ring_that_does_not_answer_are_refused(ring, fault):
    machine, runner, rows = bench(ring, answer_after=5.0)
    for _ in range(300):
        runner.step()
    getattr(machine, fault)[:] = True
    ticks = 0
    while runner.state is LoopState.CLOSED and ticks < 600:
        runner.step()
        ticks += 1
    assert runner.state is LoopState.TRIPPED
    for _ in range(5):
        runner.step()
    seen = rows.snapshot()
    spoilt = seen.closed & (seen.tick >= 299)
    assert spoilt.any()
    assert not seen.usable[spoilt].any()
    assert seen.usable[(seen.tick > 60) & (seen.tick < 150)].all()
    assert runner.believed.count >= int(np.sum(spoilt))

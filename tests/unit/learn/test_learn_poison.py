"""Rows that lie: nothing is promoted while they come, or it is rolled back within 20 ticks."""

from dataclasses import replace

import numpy as np
import pytest
from test_learn_worker import Bench

from orbitfb.core.refit import Decision

FROM, TO, END = 120, 220, 300
COLUMNS = ("orbit", "next_orbit", "readback", "applied")


def scrambled(rows):
    order = np.random.default_rng(7).permutation(rows.orbit.shape[1])
    return {"orbit": rows.orbit[:, order], "next_orbit": rows.next_orbit[:, order]}


def signs(rows):
    sign = np.where(np.random.default_rng(8).random(rows.orbit.shape[1]) < 0.3, -1.0, 1.0)
    return {"orbit": sign * rows.orbit, "next_orbit": sign * rows.next_orbit}


def constant(rows):
    stuck, after = rows.orbit.copy(), rows.next_orbit.copy()
    stuck[:, ::6] = after[:, ::6] = 3e-6
    return {"orbit": stuck, "next_orbit": after}


def ten_times(rows):
    return {"orbit": 10 * rows.orbit, "next_orbit": 10 * rows.next_orbit}


def readbacks(rows):
    return {"readback": 1.3 * rows.readback + 0.1}


def turned_changes(rows):
    return {"applied": -rows.applied}


class Poisoned(Bench):
    """A loop whose learner reads lies for a while; the loop itself reads the truth."""

    def __init__(self, lie, **settings):
        super().__init__(ticks=END, shadow={"ticks": 20}, **settings)
        self.lie = lie

    def snapshot(self, last=None, since_tick=None):
        rows = super().snapshot(last, since_tick)
        lies, when = self.lie(rows), (rows.tick >= FROM) & (rows.tick < TO)
        mixed = {
            name: np.where(when[:, None], lie, getattr(rows, name)) for name, lie in lies.items()
        }
        return replace(rows, **mixed)


@pytest.mark.parametrize("lie", [scrambled, signs, constant, ten_times, readbacks, turned_changes])
def test_lies_promote_nothing_that_stays(lie):
    bench = Poisoned(lie)
    promoted: dict[str, int] = {}
    for _ in range(END // 5 - 1):
        bench.loop.advance(5)
        bench.thread.step()
        bench.loop.policy = bench.slot.current
        for report in bench.reports:
            if report.decision is Decision.PROMOTED and bench.loop.tick > FROM:
                promoted.setdefault(report.policy_id, bench.loop.tick)
            elif report.decision is Decision.ROLLED_BACK and report.policy_id in promoted:
                assert bench.loop.tick - promoted.pop(report.policy_id) <= 20
    assert not promoted
    assert np.max(bench.loop.true_rms[60 : bench.loop.tick]) < 0.5e-6


def test_r_that_rows_refute_is_given_up():
    """What ten times too large readings taught does not stand in the way afterwards."""
    bench = Poisoned(ten_times, every=30)
    for _ in range(END // 5 - 1):
        bench.loop.advance(5)
        bench.thread.step()
    assert any("begins anew" in report.reason for report in bench.reports)
    off = bench.learner.model.response - bench.loop.plant.response
    assert np.linalg.norm(off) < 0.05 * np.linalg.norm(bench.loop.plant.response)


def test_stuck_bpms_teach_nothing():
    bench = Poisoned(constant)
    bench.loop.advance(TO)
    rows = bench.snapshot(since_tick=FROM)
    bench.learner.absorb(rows, bench.slot.current)
    with pytest.raises(Exception, match="invalid_bpms"):
        bench.learner.conclude(bench.slot.current, "on-demand")

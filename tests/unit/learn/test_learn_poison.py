"""Rows that lie: nothing is promoted while they come, or it is rolled back within 20 ticks."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest
from test_learn_worker import Bench

from orbitfb.core.errors import EstimationError
from orbitfb.core.refit import Decision
from orbitfb.learn.since import Since
from orbitfb.models.absorbed import Absorbed
from orbitfb.physics.places import Ring

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
    assert any("starts again" in report.reason for report in bench.reports)
    off = bench.learner.model.response - bench.loop.plant.response
    assert np.linalg.norm(off) < 0.05 * np.linalg.norm(bench.loop.plant.response)


def rows_that_say(chi2, nats, surprise=1.3):
    said = Absorbed(rows=10, kicks=0, chi2=chi2, chi2_other=9.0, nats=nats)
    since = Since("svd-1")
    since.add(SimpleNamespace(left_out={}, change=np.ones((10, 3)), hertz=None), said, surprise)
    return since


def test_rows_that_no_response_explains_are_no_evidence():
    """A BPM that read −1 times the orbit for a second had 317 nats, and what it taught acted."""
    assert rows_that_say(1.0, 5.0).page == 50.0
    assert rows_that_say(8.2, 5.0).page == 0.0
    assert rows_that_say(8.2, -5.0).nats == -50.0
    assert rows_that_say(8.2, 5.0, None).page == 50.0  # a whole record


def test_nothing_is_promoted_while_r_does_not_explain_the_newest_rows():
    bench = Poisoned(constant)
    bench.loop.advance(FROM)
    bench.learner.absorb(bench.snapshot(), bench.slot.current)
    _, candidate = bench.learner.conclude(bench.slot.current, "on-demand")
    assert candidate is not None
    bench.learner._since.chi2 = 8.2
    report, candidate = bench.learner.conclude(bench.slot.current, "on-demand")
    assert candidate is None and "newest rows (χ² 8.2, limit 1.3)" in report.reason


def test_stuck_bpms_teach_nothing():
    bench = Poisoned(constant)
    bench.loop.advance(TO)
    rows = bench.snapshot(since_tick=FROM)
    bench.learner.absorb(rows, bench.slot.current)
    with pytest.raises(Exception, match="invalid_bpms"):
        bench.learner.conclude(bench.slot.current, "on-demand")


def cut(rows, begin, end):
    columns = {
        f.name: getattr(rows, f.name)[begin:end] for f in fields(rows) if f.name != "auxiliary"
    }
    return replace(rows, **columns)


class Bumped(Bench):
    """An operator moves correctors beside the loop, which does not know of it."""

    def __init__(self, every, **settings):
        super().__init__(ticks=END, shadow={"ticks": 0}, minimum_rows=60, **settings)
        self.every, self.random, self.taught = every, np.random.default_rng(5), set()
        absorb = self.learner._identifier.absorb
        self.learner._identifier.absorb = lambda rows, *other: absorb(self.watch(rows), *other)

    def bump(self):
        size = self.random.uniform(0.3, 1.0) * self.random.choice([-1.0, 1.0])
        where = self.random.integers(0, 178)
        self.loop._setpoints[self.loop.tick, where : where + 3] += size * np.array([1, -1.5, 1])

    def watch(self, rows):
        """Note which ticks teach."""
        self.taught |= set(rows.tick.tolist())
        return rows

    def run(self):
        for tick in range(END - 2):
            if FROM <= tick < TO and tick % self.every == 0:
                self.bump()
            self.loop.advance(1)

    def learn(self):
        for end in range(FROM, END - 3, 2):  # as the thread does, a few rows at a time
            rows = self.snapshot(since_tick=FROM - 1)
            since = self.learner.last_tick or FROM - 2
            new = cut(rows, since + 2 - FROM, end + 1 - FROM)
            self.learner.absorb(new, self.slot.current)
        return self.learner.conclude(self.slot.current, "on-demand")[0]


def test_a_refit_over_a_bump_of_an_operator_is_refused_or_unharmed():
    bench = Bumped(every=10, ring=Ring.load())
    bench.run()
    report = bench.learn()
    assert report.figures["rows_left_out"] >= (TO - FROM) / 10  # some were looked at twice
    off = bench.learner.model.response - bench.loop.plant.response
    assert np.linalg.norm(off) < 0.02 * np.linalg.norm(bench.loop.plant.response)
    bumped = {int(tick) - 1 for tick in range(FROM, TO, 10)}
    assert bumped.isdisjoint(bench.taught)


def test_a_refit_over_a_moving_reference_is_refused_with_the_reason():
    bench = Bench(ticks=END, shadow={"ticks": 0}, minimum_rows=60)
    bench.loop.advance(TO)
    rows = bench.snapshot(since_tick=FROM)
    way = np.linspace(0.0, 100e-6, len(rows))[:, None] * np.ones(rows.orbit.shape[1])
    bench.learner.absorb(replace(rows, reference=way), bench.slot.current)
    with pytest.raises(EstimationError, match=f"left out: {len(rows) - 1} reference"):
        bench.learner.conclude(bench.slot.current, "on-demand")
    assert bench.learner.last_tick is None  # not one row taught
    half = np.where(np.arange(len(rows))[:, None] < 50, way, way[50])
    bench.learner.absorb(replace(rows, reference=half), bench.slot.current)
    report, candidate = bench.learner.conclude(bench.slot.current, "on-demand")
    assert report.decision is Decision.REFUSED and candidate is None
    assert report.reason.startswith("only ") and "reference" in report.reason

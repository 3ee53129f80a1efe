"""The learner's thread, stepped by hand: triggers, swap, watch, roll-back, failures."""

import numpy as np
import pytest

from benchmarks.small_ring import small_ring
from orbitfb.core.clock import ManualClock
from orbitfb.core.refit import AlarmCause, Decision, Stage
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.learner import Learner
from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.trainer import InlineTrainer
from orbitfb.learn.worker import LearnerThread
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = small_ring()


def law(response):
    return SvdPolicy(response, SvdSettings())


def build(model, incumbent):
    return SvdPolicy(model.response, SvdSettings(), covariance=model.row_covariance)


class Bench:
    """A ring, a loop that obeys the slot, and the thread's work without the thread."""

    def __init__(self, factor=1.0, ticks=2000, records=None, ring=RING, **settings):
        plant = Plant(ring, seed=2)
        truth = plant.response
        self.slot = PolicySlot(law(factor * truth))
        self.loop = ClosedLoop(plant, self.slot.current, ticks)
        self.reports, self.kept = [], []
        chosen = {
            "identify": {"prior_relative": 0.02 if factor == 1.0 else 1.0},
            "shadow": {"ticks": 0},
        }
        settings = LearnSettings(**chosen | settings)
        self.learner = Learner(factor * truth, settings, build, ManualClock())
        self.clock = ManualClock()
        self.thread = LearnerThread(
            InlineTrainer(self.learner),
            self,
            self.slot,
            self.reports.append,
            lambda *kept: self.kept.append(kept),
            clock=self.clock,
            tripped=lambda: self.tripped,
            records=records,
        )
        self.tripped = False

    def snapshot(self, last=None, since_tick=None):
        if last is not None:
            return self.loop.transitions(self.loop.tick - 1 - last)
        return self.loop.transitions(since_tick or 0)

    def advance(self, ticks, every=20):
        for _ in range(0, ticks, every):
            self.loop.advance(every)
            self.thread.step()
            self.loop.policy = self.slot.current


def test_periodic_refit_promotes_a_better_law_and_keeps_it():
    bench = Bench(factor=0.4)
    bench.advance(300)
    promoted = [r for r in bench.reports if r.decision is Decision.PROMOTED]
    assert promoted and promoted[0].policy_id == bench.kept[0][0].policy_id
    assert bench.slot.swaps == len(promoted)
    assert bench.slot.current.policy_id == promoted[-1].policy_id
    assert {r.trigger for r in bench.reports} <= {"periodic", "degradation"}


def test_refits_come_at_the_chosen_interval():
    bench = Bench(every=100, chi2_trigger=50.0, ring=Ring.load())
    bench.advance(420)
    assert [r.trigger for r in bench.reports] == ["periodic"] * 4


def test_a_surprise_brings_the_refit_forward():
    bench = Bench(every=10_000, check=20)
    bench.advance(200)
    assert bench.reports == []
    bench.loop.plant.kick(0.0)
    wrong = law(bench.loop.plant.response * 1.5)
    bench.slot.swap(wrong)
    bench.loop.policy = wrong
    bench.loop.plant.kick(50e-6)
    bench.advance(60)
    assert bench.reports and bench.reports[0].trigger == "degradation"


def test_on_demand_without_activation_changes_nothing():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e6)
    bench.advance(200)
    before = bench.slot.current
    future = bench.thread.request(activate=False)
    bench.thread.step()
    report = future.result(timeout=0)
    assert report.decision is Decision.ACCEPTED
    assert bench.kept[-1][0].policy_id == report.policy_id
    assert bench.slot.current is before and bench.slot.swaps == 0
    future = bench.thread.request()
    bench.thread.step()
    assert future.result(timeout=0).decision is Decision.PROMOTED
    assert bench.slot.swaps == 1


def test_rolls_back_when_the_orbit_gets_worse():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e6, rollback_factor=1.5)
    bench.advance(400)
    before = bench.slot.current
    bench.thread.request()
    bench.thread.step()
    assert bench.slot.current is not before
    # What no judge can know: the promoted law meets a ring that it makes unstable.
    bench.loop.policy = law(-bench.loop.plant.response)
    bench.loop.advance(20)
    bench.thread.step()
    assert bench.slot.current is before
    last = bench.reports[-1]
    assert (last.decision, last.trigger) == (Decision.ROLLED_BACK, "watch")
    assert last.incumbent_id == before.policy_id
    assert bench.kept[-1][0] is before


def test_does_not_roll_back_over_an_operators_choice():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e30)
    bench.advance(400)
    bench.thread.request()
    bench.thread.step()
    chosen = law(-bench.loop.plant.response)
    bench.slot.swap(chosen)
    bench.loop.policy = chosen
    bench.loop.advance(20)
    bench.thread.step()
    assert bench.slot.current is chosen


def test_a_good_swap_is_kept():
    bench = Bench(factor=0.4, every=100)
    bench.advance(400)
    assert Decision.ROLLED_BACK not in {r.decision for r in bench.reports}


def test_a_failure_is_a_refused_report_and_not_the_end(monkeypatch):
    bench = Bench(every=20)
    monkeypatch.setattr(bench.learner, "conclude", lambda *_: 1 / 0)
    bench.advance(100)
    assert bench.reports[-1].decision is Decision.REFUSED
    assert "ZeroDivisionError" in bench.reports[-1].reason
    future = bench.thread.request()
    bench.thread.step()
    assert "ZeroDivisionError" in future.result(timeout=0).reason
    monkeypatch.undo()
    bench.advance(100)
    assert "ZeroDivisionError" not in bench.reports[-1].reason


def test_unusable_data_are_told_apart_from_a_fault():
    bench = Bench()
    bench.loop.advance(3)
    future = bench.thread.request()
    bench.thread.step()
    assert "only 1 rows" in future.result(timeout=0).reason


def test_thread_serves_requests_and_stops():
    bench = Bench()
    bench.loop.advance(100)
    bench.thread.start()
    report = bench.thread.request().result(timeout=30)
    assert report.trigger == "on-demand"
    bench.thread.stop(timeout=10)
    assert not bench.thread.is_alive()


def test_stop_cancels_what_waits():
    bench = Bench()
    future = bench.thread.request()
    bench.thread.stop()
    assert future.cancelled()


@pytest.mark.parametrize("enabled", [True, False])
def test_a_disabled_learner_refits_only_on_demand(enabled):
    bench = Bench(enabled=enabled)
    bench.advance(240)
    assert bool(bench.reports) is enabled
    bench.thread.request()
    bench.thread.step()
    assert bench.reports[-1].trigger == "on-demand"
    assert np.isfinite(bench.reports[-1].figures["chi2"])


def test_an_accepted_candidate_runs_in_shadow_before_it_acts():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e6, shadow={"ticks": 20})
    bench.advance(200)
    before = bench.slot.current
    future = bench.thread.request()
    bench.thread.step()
    bench.advance(10, every=5)
    assert not future.done() and bench.slot.current is before and not bench.kept
    bench.advance(15, every=5)
    report = future.result(timeout=0)
    assert (report.decision, report.stage) == (Decision.PROMOTED, Stage.SHADOW)
    assert report.figures["shadow_ticks"] == 20
    assert report.figures["shadow_rms_candidate"] < report.figures["shadow_rms_incumbent"]
    assert bench.slot.current.policy_id == report.policy_id == bench.kept[0][0].policy_id


def test_a_candidate_in_shadow_is_dropped_when_an_operator_swaps():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e30, shadow={"ticks": 20})
    bench.advance(200)
    future = bench.thread.request()
    bench.thread.step()
    chosen = law(bench.loop.plant.response)
    bench.slot.swap(chosen)
    bench.thread.step()
    report = future.result(timeout=0)
    assert (report.decision, report.stage) == (Decision.REFUSED, Stage.SHADOW)
    assert "another policy" in report.reason and bench.slot.current is chosen


def test_an_operators_choice_while_the_candidate_is_stored_stays():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e30)
    bench.advance(200)
    chosen = law(bench.loop.plant.response)

    def keep(policy, report):
        bench.kept.append((policy, report))
        if report.decision is Decision.PROMOTED:
            bench.slot.swap(chosen)  # between the last look at the slot and the swap

    bench.thread._succession._keep = keep
    future = bench.thread.request()
    bench.thread.step()
    report = future.result(timeout=0)
    assert report.decision is Decision.REFUSED
    assert report.reason.startswith("another policy was put in force")
    assert bench.slot.current is chosen
    policy, report = bench.kept[1]
    assert policy is chosen and report.decision is Decision.ROLLED_BACK


def test_a_second_request_waits_for_the_first_candidate():
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e30, shadow={"ticks": 20})
    bench.advance(200)
    first, second = bench.thread.request(), bench.thread.request()
    bench.thread.step()
    assert not first.done() and not second.done()
    bench.advance(25, every=5)
    assert first.result(timeout=0).decision is Decision.PROMOTED
    assert second.result(timeout=0).number == 2


def test_a_policy_that_trips_the_loop_is_left_and_does_not_come_again(monkeypatch):
    bench = Bench(factor=0.4, every=10_000, chi2_trigger=1e30)
    bench.advance(200)
    before = bench.slot.current
    promoted = bench.thread.request()
    bench.thread.step()
    bad = bench.slot.current
    assert bad is not before and promoted.result(timeout=0).policy_id == bad.policy_id
    bench.loop.advance(2)
    bench.tripped = True
    bench.thread.step()
    assert bench.slot.current is before
    assert "the loop tripped" in bench.reports[-1].reason
    bench.tripped = False
    monkeypatch.setattr(bench.learner, "_build", lambda *_: bad)
    bench.advance(60)
    again = bench.thread.request()
    bench.thread.step()
    assert again.result(timeout=0).decision is Decision.REFUSED
    assert bench.slot.current is before


def test_an_alarm_is_told_once_and_leads_to_a_refit():
    alarms = []
    bench = Bench(every=10_000)
    bench.thread._alarmed = alarms.append
    bench.advance(200)
    wrong = law(bench.loop.plant.response * 1.5)
    bench.slot.swap(wrong)
    bench.loop.policy = wrong
    bench.loop.plant.kick(50e-6)
    bench.advance(60)
    assert [alarm.cause for alarm in alarms[:1]] == [AlarmCause.SURPRISE]
    assert alarms[0].statistic > alarms[0].threshold
    assert bench.reports[0].trigger == "degradation"


class Notes:
    """Keeps what is put on record."""

    def __init__(self, fault=""):
        self.said, self.fault = [], fault

    def proved(self, identifier):
        self.said.append(("proved", identifier))

    def suspended(self, identifier, seen):
        self.said.append(("suspended", identifier, seen))

    def fault_of(self, identifier):
        return self.fault


QUIET = {"factor": 0.4, "every": 10_000, "chi2_trigger": 1e30}


def test_a_policy_that_passes_its_watch_has_proved_itself():
    bench = Bench(records=Notes(), watch=40, **QUIET)
    notes = bench.thread._succession._records
    bench.advance(200)
    bench.thread.request()
    bench.thread.step()
    bench.advance(30, every=10)
    assert notes.said == []
    bench.advance(40)
    assert notes.said == [("proved", bench.slot.current.policy_id)]
    bench.thread.stop()
    assert len(notes.said) == 1


def test_a_watch_is_suspended_with_its_count_and_goes_on_in_the_next_service():
    bench = Bench(records=Notes(), **QUIET)
    bench.advance(200)
    before = bench.slot.current
    bench.thread.request()
    bench.thread.step()
    bench.advance(40)
    promoted = bench.slot.current
    bench.thread.stop()
    ((word, name, seen),) = bench.thread._succession._records.said
    assert (word, name) == ("suspended", promoted.policy_id) and 30 < seen <= 40
    again = Bench(records=Notes(), **QUIET)
    again.slot.swap(promoted)
    again.thread.resume(before, 2e-7, seen)
    again.loop.advance(20)
    again.tripped = True
    again.thread.step()
    assert again.slot.current is before
    assert again.reports[-1].decision is Decision.ROLLED_BACK
    assert again.reports[-1].figures["watched_ticks"] > seen


def test_what_is_on_record_as_failed_is_not_promoted():
    bench = Bench(records=Notes("tripped the loop: rms"), **QUIET)
    bench.advance(200)
    before = bench.slot.current
    asked = bench.thread.request()
    bench.thread.step()
    assert asked.result(timeout=0).decision is Decision.REFUSED
    assert "does not come again: it tripped the loop: rms" in asked.result(timeout=0).reason
    assert bench.slot.current is before and not bench.kept

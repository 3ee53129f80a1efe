"""Which policy a service begins with: what was activated runs, or it is said why not."""

from pathlib import Path

import numpy as np
import pytest
from structlog.testing import capture_logs

from orbitfb.app.service.active_policy import Keeper
from orbitfb.core.errors import StoreError
from orbitfb.core.refit import Decision, RefitReport, Stage
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()
CHANNELS = RING.channels("x")
NOMINAL = response(RING, "x")
ALL = np.ones(len(CHANNELS.correctors), dtype=np.bool_)
SVD = SvdPolicy(NOMINAL, SvdSettings())
MODAL = ModalPolicy(NOMINAL, ModalSettings())
TRAINED = ModalPolicy(1.01 * NOMINAL, ModalSettings())
LEARNT = SvdPolicy(0.99 * NOMINAL, SvdSettings())


@pytest.fixture
def store(tmp_path: Path) -> PolicyStore:
    store = PolicyStore(tmp_path)
    for policy in (SVD, MODAL, TRAINED, LEARNT):
        store.save(policy, CHANNELS)
    store.begin(SVD.policy_id)
    return store


@pytest.fixture
def keeper(store: PolicyStore) -> Keeper:
    return Keeper(store, CHANNELS, 3)


@pytest.mark.parametrize("new_ring", [True, False])
@pytest.mark.parametrize(("nominal", "asked"), [(MODAL, True), (MODAL, False), (SVD, False)])
def test_what_was_activated_runs_and_stays(store, keeper, new_ring, nominal, asked):
    store.activate(TRAINED.policy_id)
    first = keeper.first(nominal, ALL, new_ring, asked)
    assert first.policy_id == store.active() == store.chosen() == TRAINED.policy_id
    assert keeper.reason == (
        "the activated policy" if new_ring else "the policy that was in force before"
    )


def test_another_kind_begins_a_new_ring_and_the_activation_is_told_and_kept(store, keeper):
    store.activate(TRAINED.policy_id)
    assert keeper.first(SVD, ALL, new_ring=True, asked=True) is SVD
    assert f"--policy asks for; {TRAINED.policy_id} was activated" in keeper.reason
    assert (store.active(), store.chosen()) == (SVD.policy_id, TRAINED.policy_id)
    again = keeper.first(SVD, ALL, new_ring=True)
    assert again.policy_id == store.active() == TRAINED.policy_id


def test_another_kind_does_not_displace_what_is_in_force_on_a_ring_that_goes_on(store, keeper):
    store.activate(LEARNT.policy_id, by="service")
    keeper.proved(LEARNT.policy_id)
    assert keeper.first(MODAL, ALL, new_ring=False, asked=True).policy_id == LEARNT.policy_id
    assert f"--policy asks for another kind, that of {MODAL.policy_id}" in keeper.reason


def test_what_a_service_identified_is_not_about_a_new_ring(store, keeper):
    store.activate(LEARNT.policy_id, by="service")
    assert keeper.first(SVD, ALL, new_ring=True) is SVD
    assert f"{LEARNT.policy_id} was in force on an earlier" in keeper.reason
    assert store.active() == SVD.policy_id


def test_a_learner_does_not_make_an_activation_forgotten(store, keeper):
    store.activate(TRAINED.policy_id)
    for gain in np.linspace(0.1, 0.4, 6):
        learnt = SvdPolicy(NOMINAL, SvdSettings(gain=float(gain)))
        store.activate(store.save(learnt, CHANNELS), by="service")
    store.prune(3)
    assert keeper.first(SVD, ALL, new_ring=True).policy_id == TRAINED.policy_id == store.active()


def test_churn_of_the_learner_removes_its_own_and_logs_each(store, keeper):
    users = {card.id for card in store.cards()}
    promoted = []
    with capture_logs() as events:
        for gain in np.linspace(0.1, 0.4, 6):
            learnt = SvdPolicy(NOMINAL, SvdSettings(gain=float(gain)))
            above = store.active()
            keeper.keep(learnt, report(Decision.PROMOTED, learnt.policy_id, above, rms_before=2e-7))
            keeper.proved(learnt.policy_id)
            promoted.append(learnt.policy_id)
    there = {card.id for card in store.cards()}
    assert users <= there
    gone = [event["policy"] for event in events if event["event"] == "policy_removed"]
    assert gone and set(gone) == set(promoted) - there


def test_going_back_is_a_choice_too(store, keeper):
    for policy, by in ((TRAINED, "operator"), (LEARNT, "service"), (MODAL, "operator")):
        store.activate(policy.policy_id, by)
    store.rollback()
    assert keeper.first(SVD, ALL, new_ring=True).policy_id == LEARNT.policy_id


def test_activating_what_a_service_began_with_makes_it_the_choice(store, keeper):
    store.activate(SVD.policy_id)
    assert keeper.first(MODAL, ALL, new_ring=True).policy_id == SVD.policy_id
    store.activate(SVD.policy_id, by="service")
    assert store.chosen() == SVD.policy_id
    assert len(store.activations()) == 1


@pytest.mark.parametrize("new_ring", [True, False])
def test_what_was_activated_for_other_planes_is_refused(store, new_ring):
    store.activate(TRAINED.policy_id)
    keeper = Keeper(store, RING.channels("y"), 3)
    with pytest.raises(StoreError, match="is a policy for planes 'x', the ring runs 'y'"):
        keeper.first(SvdPolicy(response(RING, "y"), SvdSettings()), ALL, new_ring)


def report(decision, policy, other, stage=Stage.SHADOW, reason="worse", **figures):
    return RefitReport(1, 0.0, "periodic", 9, decision, reason, policy, other, figures, 0.1, stage)


def promote(keeper):
    keeper.keep(LEARNT, report(Decision.PROMOTED, LEARNT.policy_id, SVD.policy_id, rms_before=2e-7))


def test_after_a_kill_the_policy_on_probation_is_taken_back(store, keeper):
    promote(keeper)
    after = Keeper(PolicyStore(store.path), CHANNELS, 3)
    assert after.first(MODAL, ALL, new_ring=False).policy_id == SVD.policy_id == store.active()
    assert after.resumed is None and store.probation() is None
    assert f"{LEARNT.policy_id} was on probation and the service before this one was killed" in (
        after.reason
    )
    assert keeper.fault_of(LEARNT.policy_id) == ""  # nobody knows what happened


def test_after_an_end_in_good_order_the_probation_goes_on_until_the_next_kill(store, keeper):
    promote(keeper)
    keeper.suspended(LEARNT.policy_id, 30)
    after = Keeper(store, CHANNELS, 3)
    assert after.first(MODAL, ALL, new_ring=False).policy_id == LEARNT.policy_id
    assert after.resumed is not None and after.resumed.former.policy_id == SVD.policy_id
    assert (after.resumed.probation.seen, after.resumed.probation.before) == (30, 2e-7)
    killed = Keeper(store, CHANNELS, 3)
    assert killed.first(MODAL, ALL, new_ring=False).policy_id == SVD.policy_id


def test_nobody_on_probation_runs_where_no_learner_watches(store, keeper):
    promote(keeper)
    keeper.suspended(LEARNT.policy_id, 30)
    after = Keeper(store, CHANNELS, 3, watches=False)
    assert after.first(MODAL, ALL, new_ring=False).policy_id == SVD.policy_id
    assert "the learner, which would watch it, is off" in after.reason


def test_what_passed_its_watch_is_in_force_after_a_kill(store, keeper):
    promote(keeper)
    keeper.proved(LEARNT.policy_id)
    after = Keeper(store, CHANNELS, 3)
    assert after.first(MODAL, ALL, new_ring=False).policy_id == LEARNT.policy_id
    assert after.resumed is None


def test_a_roll_back_is_on_record_and_an_overtaken_promotion_is_not(store, keeper):
    promote(keeper)
    keeper.keep(SVD, report(Decision.ROLLED_BACK, LEARNT.policy_id, SVD.policy_id))
    assert keeper.fault_of(LEARNT.policy_id) == "" and store.active() == SVD.policy_id
    promote(keeper)
    back = report(Decision.ROLLED_BACK, LEARNT.policy_id, SVD.policy_id, Stage.WATCH, "too large")
    keeper.keep(SVD, back)
    assert Keeper(store, CHANNELS, 3).fault_of(LEARNT.policy_id) == "was rolled back: too large"
    store.activate(MODAL.policy_id)
    store.activate(SVD.policy_id)
    assert store.previous() == MODAL.policy_id


def test_only_promotions_are_the_learners_to_remove(store, keeper):
    asked, made = (SvdPolicy(NOMINAL, SvdSettings(gain=gain)) for gain in (0.11, 0.12))
    keeper.keep(asked, report(Decision.ACCEPTED, asked.policy_id, SVD.policy_id))
    keeper.keep(made, report(Decision.PROMOTED, made.policy_id, SVD.policy_id))
    owners = {card.id: card.owner for card in store.cards()}
    assert owners[asked.policy_id] == "operator" and owners[made.policy_id] == "learner"

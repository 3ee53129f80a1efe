"""Which policy a service begins with: what was activated runs, or it is said why not."""

from pathlib import Path

import numpy as np
import pytest

from orbitfb.core.errors import StoreError
from orbitfb.keeper import Keeper
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.store import PolicyStore
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
    store.activate(SVD.policy_id, by="service")
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
    assert keeper.reason == ("as it was activated" if new_ring else "as it was in force before")


def test_another_kind_begins_a_new_ring_and_the_activation_is_told_and_kept(store, keeper):
    store.activate(TRAINED.policy_id)
    assert keeper.first(SVD, ALL, new_ring=True, asked=True) is SVD
    assert f"--policy asks for; {TRAINED.policy_id}, which was activated" in keeper.reason
    assert (store.active(), store.chosen()) == (SVD.policy_id, TRAINED.policy_id)
    again = keeper.first(SVD, ALL, new_ring=True)
    assert again.policy_id == store.active() == TRAINED.policy_id


def test_another_kind_does_not_displace_what_is_in_force_on_a_ring_that_goes_on(store, keeper):
    store.activate(LEARNT.policy_id, by="service")
    assert keeper.first(MODAL, ALL, new_ring=False, asked=True).policy_id == LEARNT.policy_id
    assert f"--policy asks for another kind, as {MODAL.policy_id} is" in keeper.reason


def test_what_a_service_identified_is_not_about_a_new_ring(store, keeper):
    store.activate(LEARNT.policy_id, by="service")
    assert keeper.first(SVD, ALL, new_ring=True) is SVD
    assert f"{LEARNT.policy_id} was put in force by a service" in keeper.reason
    assert store.active() == SVD.policy_id


def test_a_learner_does_not_make_an_activation_forgotten(store, keeper):
    store.activate(TRAINED.policy_id)
    for gain in np.linspace(0.1, 0.4, 6):
        learnt = SvdPolicy(NOMINAL, SvdSettings(gain=float(gain)))
        store.activate(store.save(learnt, CHANNELS), by="service")
    store.prune(3)
    assert keeper.first(SVD, ALL, new_ring=True).policy_id == TRAINED.policy_id == store.active()


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

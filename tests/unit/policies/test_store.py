"""The policy store: what goes in comes out, and nothing else does."""

import json
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from store_examples import make_modal, make_network, make_policy, ring

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import StoreError
from orbitfb.core.files.whole import remove_directory
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    bpms=st.integers(1, 9),
    correctors=st.integers(1, 9),
    gain=st.floats(0.01, 2.0, exclude_max=True),
    cautious=st.booleans(),
)
def test_what_is_stored_comes_back_bit_for_bit(
    tmp_path_factory, seed, bpms, correctors, gain, cautious
):
    store = PolicyStore(tmp_path_factory.mktemp("store"), ManualClock())
    rng = np.random.default_rng(seed)
    response = rng.normal(size=(bpms, correctors))
    root = rng.normal(size=(correctors, correctors))
    covariance = root @ root.T if cautious else None
    policy = SvdPolicy(response, SvdSettings(gain=gain), covariance=covariance)
    loaded = store.load(store.save(policy, ring(bpms, correctors)), ring(bpms, correctors))
    assert loaded.policy_id == policy.policy_id
    assert loaded.settings == policy.settings
    np.testing.assert_array_equal(loaded.response, response)
    np.testing.assert_array_equal(loaded.gain_matrix, policy.gain_matrix)
    assert (loaded.covariance is None) == (covariance is None)


def test_the_card_says_where_a_policy_comes_from(store):
    identifier = store.save(
        make_policy(), ring(), "svd-parent", "abc", {"rms": 1e-7, "ratio": float("nan")}
    )
    card = store.card(identifier)
    assert (card.parent, card.data_hash, card.kind) == ("svd-parent", "abc", "svd")
    assert card.figures == {"rms": 1e-7, "ratio": None}
    assert card.created == ManualClock().wall()
    assert card.bpms == ring().bpms


def test_storing_again_changes_nothing(store):
    first = store.save(make_policy(), ring(), figures={"rms": 1.0})
    again = store.save(make_policy(), ring(), figures={"rms": 2.0})
    assert first == again
    assert store.card(first).figures == {"rms": 1.0}
    assert len(store.cards()) == 1


def test_another_policy_of_the_same_id_is_refused(store):
    store.save(SvdPolicy(np.eye(4), SvdSettings(), "golden"), ring(4, 4))
    with pytest.raises(StoreError, match="another policy of the same id"):
        store.save(SvdPolicy(2 * np.eye(4), SvdSettings(), "golden"), ring(4, 4))


def test_activation_and_rollback_are_a_stack(store):
    first, second, third = (store.save(make_policy(seed), ring()) for seed in range(3))
    assert store.active() is None
    for identifier in (first, second, second, third):
        store.activate(identifier)
    assert store.active() == third
    assert store.rollback() == second
    assert store.rollback() == first
    with pytest.raises(StoreError, match="no policy was active before"):
        store.rollback()
    assert PolicyStore(store.path).active() == first


def test_going_back_does_not_lead_to_a_policy_that_was_withdrawn(store):
    good, better, bad = (make_policy(seed=seed) for seed in (1, 2, 3))
    for policy in (good, better, bad):
        store.save(policy, ring())
        store.activate(policy.policy_id)
    store.withdraw(bad.policy_id, better.policy_id)
    assert store.active() == better.policy_id
    assert store.rollback() == good.policy_id
    store.activate(bad.policy_id)  # by name it may come again
    store.activate(good.policy_id)
    store.withdraw(bad.policy_id, good.policy_id)
    assert [entry.id for entry in store.activations()] == [good.policy_id]
    with pytest.raises(StoreError, match="there is no policy"):
        store.withdraw(good.policy_id, "nothing")
    assert store.active() == good.policy_id


@pytest.mark.parametrize("identifier", ["", "..", "../x", "a/b", ".hidden", "a" * 101, "a\n", "/x"])
def test_an_id_cannot_leave_the_store(store, identifier):
    for use in (store.card, store.activate, lambda name: store.load(name, ring())):
        with pytest.raises(StoreError, match="no policy id"):
            use(identifier)
    if identifier:
        with pytest.raises(StoreError, match="no policy id"):
            store.save(SvdPolicy(np.ones((5, 4)), SvdSettings(), identifier), ring())


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (ring(planes="y"), "planes 'x', the ring runs 'y'"),
        (ring(bpms=6), "5 BPMs, the ring has 6"),
        (ring(correctors=3), "4 correctors, the ring has 3"),
        (ring(prefix="other "), "number 0 of its BPMs is BPM0, here it is other BPM0"),
    ],
)
def test_a_policy_of_another_ring_is_refused(store, other, words):
    identifier = store.save(make_policy(), ring())
    with pytest.raises(StoreError, match=words):
        store.load(identifier, other)


def test_many_writers_at_once_lose_nothing(store):
    identifiers, failures = [], []

    def work(seed):
        try:
            mine = PolicyStore(store.path)
            identifier = mine.save(make_policy(seed % 3), ring())
            mine.activate(identifier)
            identifiers.append(identifier)
        except StoreError as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(9)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not failures
    assert {card.id for card in store.cards()} == set(identifiers)
    assert store.active() in identifiers


def test_pruning_removes_old_promotions_of_the_learner_and_nothing_else(tmp_path):
    clock = ManualClock()
    store = PolicyStore(tmp_path, clock)
    baseline, trained, imported, chosen, *learnt = (make_policy(seed) for seed in range(10))

    def save(policy, **more):
        clock.advance(1.0)
        return store.save(policy, ring(), **more)

    store.begin(save(baseline))
    save(trained, training={"method": "trajectory"})
    save(imported)
    store.activate(save(chosen, owner="learner"))  # an operator's choice is the operator's
    ids = [save(policy, owner="learner") for policy in learnt]
    for identifier in ids:
        store.activate(identifier, by="service")
        store.set_probation(identifier, None)
    assert store.prune(keep=2) == ids[:4]
    users = {policy.policy_id for policy in (baseline, trained, imported, chosen)}
    assert {card.id for card in store.cards()} == users | set(ids[4:])
    assert [entry.id for entry in store.activations()] == [
        baseline.policy_id,
        chosen.policy_id,
        *ids[4:],
    ]
    assert store.card(chosen.policy_id).owner == "operator"
    assert store.prune(keep=2) == []


def test_what_the_learner_made_and_an_operator_stores_too_is_the_operators(store):
    ids = [store.save(make_policy(seed), ring(), owner="learner") for seed in range(4)]
    store.save(make_policy(0), ring(), training={"method": "svd"})
    assert store.card(ids[0]).owner == "operator"
    assert ids[0] not in store.prune(keep=1)
    store.save(make_policy(0), ring(), owner="learner")
    assert store.card(ids[0]).owner == "operator"


def test_each_removal_is_told_also_before_one_that_fails(store, monkeypatch):
    for seed in range(5):
        store.save(make_policy(seed), ring(), owner="learner")
    told, failing = [], []

    def remove(path):
        if len(told) == 2:
            failing.append(path)
            raise PermissionError(13, "Permission denied")
        remove_directory(path)

    monkeypatch.setattr("orbitfb.policies.store.directory.remove_directory", remove)
    with pytest.raises(StoreError, match="cannot be removed"):
        store.prune(1, told.append)
    left = {card.id for card in store.cards()}
    assert len(told) == 2 and left.isdisjoint(told) and len(left) == 3
    assert failing[0].name in left


def test_a_policy_that_there_is_not_is_answered_with_the_nearest(store):
    identifier = store.save(make_policy(), ring())
    with pytest.raises(StoreError, match=f"did you mean {identifier}"):
        store.card(identifier[:-2])


def test_what_a_probation_may_go_back_to_stays(tmp_path):
    clock = ManualClock()
    store = PolicyStore(tmp_path, clock)
    ids = []
    for seed in range(5):
        ids.append(store.save(make_policy(seed), ring(), owner="learner"))
        clock.advance(1.0)
    store.begin(ids[0])
    store.activate(ids[1], by="service")
    assert store.probation().former == ids[0]
    assert ids[0] not in store.prune(keep=1)


def test_going_back_passes_over_what_failed(store):
    first, second, bad, last = (store.save(make_policy(seed), ring()) for seed in range(4))
    for identifier in (first, second, bad, last):
        store.activate(identifier)
    store.failed(bad, "tripped", "rms orbit error 1005 µm exceeds 1000 µm")
    assert store.previous() == second
    assert store.previous(force=True) == bad
    assert store.rollback() == second
    assert PolicyStore(store.path).active() == second
    store.failed(first, "rolled_back", "after the swap the orbit stayed above 0.4 µm rms")
    with pytest.raises(StoreError, match=r"was rolled back: after the swap .* --force"):
        store.rollback()
    assert store.active() == second
    assert store.rollback(force=True) == first


def test_going_back_never_leads_to_the_policy_that_is_left(store):
    good, bad = (store.save(make_policy(seed), ring()) for seed in range(2))
    for identifier in (good, bad, good):
        store.activate(identifier)
    store.failed(bad, "tripped", "x")
    with pytest.raises(StoreError, match="may be gone back to"):
        store.rollback()


def test_going_back_passes_over_what_would_run_away_and_what_is_damaged(store):
    good, damaged, last = (store.save(make_policy(seed), ring()) for seed in range(3))
    wild = make_policy(3, gain=1.8, integral_gain=1.0, regularisation=0.0)
    unstable = store.save(wild, ring())
    assert "would grow" in store.card(unstable).warning
    for identifier in (good, damaged, unstable, last):
        store.activate(identifier)
    (store.path / damaged / "card.json").write_text("{}")
    assert store.rollback() == good


def test_failures_are_on_record_beyond_the_policy_and_the_program(store):
    identifier = store.save(make_policy(), ring(), owner="learner")
    store.failed(identifier, "tripped", "first")
    store.failed(identifier, "rolled_back", "x" * 1000)
    again = PolicyStore(store.path).failures()
    assert list(again) == [identifier]
    assert again[identifier].cause == "rolled_back" and len(again[identifier].reason) == 400
    (store.path / "failures.json").write_text("[]")
    with pytest.raises(StoreError, match=r"failures\.json holds no JSON object; repair"):
        store.failures()


def test_a_promotion_is_on_probation_and_an_operators_choice_is_not(store):
    first, second = (store.save(make_policy(seed), ring()) for seed in range(2))
    store.activate(first, by="service")
    assert store.probation() is None  # there is nothing to go back to
    store.activate(second, by="service", before=2e-7)
    probation = PolicyStore(store.path).probation()
    assert (probation.former, probation.before, probation.suspended) == (first, 2e-7, False)
    store.set_probation("svd-another", None)
    assert store.probation() == probation
    store.activate(second)  # by name
    assert store.probation() is None
    store.begin(first)
    assert store.probation() is None


@pytest.mark.parametrize("make", [make_modal, make_network])
@pytest.mark.parametrize("size", [(1, 1), (3, 7), (7, 3)])
def test_the_other_kinds_come_back_bit_for_bit(store, make, size):
    policy = make(3, *size)
    loaded = store.load(store.save(policy, ring(*size)), ring(*size))
    assert type(loaded) is type(policy)
    assert (loaded.policy_id, loaded.settings) == (policy.policy_id, policy.settings)
    error, valid = np.linspace(-1e-6, 3e-6, size[0]), np.ones(size[0], dtype=bool)
    np.testing.assert_array_equal(
        loaded.act(error, valid, None)[0], policy.act(error, valid, None)[0]
    )
    np.testing.assert_array_equal(loaded.gain_matrix, policy.gain_matrix)


def test_a_modal_law_keeps_thresholds_without_end(store):
    loaded = store.load(store.save(make_modal(threshold=None), ring()), ring())
    assert np.isinf(loaded.thresholds).all()


def test_the_card_tells_the_training(store):
    training = {
        "method": "trajectory",
        "settings": {"learning_rate": 1e-3, "sizes": (5, 15)},
        "seeds": [1, 2],
        "figures": {"final": float("inf")},
    }
    card = store.card(store.save(make_network(), ring(), training=training))
    assert card.kind == "network"
    assert card.training == {
        "method": "trajectory",
        "settings": {"learning_rate": 1e-3, "sizes": [5, 15]},
        "seeds": [1, 2],
        "figures": {"final": None},
    }
    assert store.card(store.save(make_policy(), ring())).training is None


def test_a_card_of_the_first_version_is_read(store):
    """What version 1 wrote: no `training`, no key of the derivative in the settings."""
    policy = make_policy()
    identifier = store.save(policy, ring())
    path = store.path / identifier / "card.json"
    card = json.loads(path.read_text())
    del card["training"]
    card["schema_version"] = 1
    card["settings"] = {k: v for k, v in card["settings"].items() if "derivative" not in k}
    path.write_text(json.dumps(card))
    loaded = store.load(identifier, ring())
    assert loaded.settings == policy.settings
    assert store.save(loaded, ring()) == identifier  # the same policy, not another of its name


def test_under_a_mask_the_policy_inside_is_stored(store):
    inside = make_modal()
    masked = MaskedPolicy(inside, inside.response, np.array([True, False, True, True]))
    assert store.save(masked, ring()) == inside.policy_id
    assert type(store.load(inside.policy_id, ring())) is ModalPolicy


def test_a_stranger_is_not_stored(store):
    class Stranger:
        policy_id = "stranger"

    with pytest.raises(StoreError, match="svd, modal, adaptive, network"):
        store.save(Stranger(), ring())

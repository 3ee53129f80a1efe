"""The policy store: what goes in comes out, and nothing else does."""

import hashlib
import json
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import StoreError
from orbitfb.core.signals import Channels
from orbitfb.policies import files
from orbitfb.policies.store import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def ring(bpms=5, correctors=4, planes="x", prefix=""):
    names = tuple(f"{prefix}BPM{i}" for i in range(bpms))
    magnets = tuple(f"{prefix}COR{i}" for i in range(correctors))
    return Channels(planes, names, magnets, names, magnets, magnets)


def make_policy(seed=0, bpms=5, correctors=4, **chosen):
    rng = np.random.default_rng(seed)
    return SvdPolicy(1e-3 * rng.normal(size=(bpms, correctors)), SvdSettings(**chosen))


@pytest.fixture
def store(tmp_path):
    return PolicyStore(tmp_path / "policies", ManualClock())


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    bpms=st.integers(1, 9),
    correctors=st.integers(1, 9),
    gain=st.floats(0.01, 2.0),
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


def test_a_missing_or_damaged_policy_is_not_activated(store):
    good, bad = (store.save(make_policy(seed), ring()) for seed in range(2))
    store.activate(good)
    (store.path / bad / "policy.safetensors").write_bytes(b"")
    for identifier in ("svd-nowhere", bad):
        with pytest.raises(StoreError):
            store.activate(identifier)
    assert store.active() == good


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


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_no_damage_to_the_tensor_file_goes_unnoticed(tmp_path_factory, data):
    store = PolicyStore(tmp_path_factory.mktemp("store"), ManualClock())
    identifier = store.save(make_policy(), ring())
    path = store.path / identifier / "policy.safetensors"
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans(), label="truncate"):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"policy\.safetensors.*remove .* and refit"):
        store.load(identifier, ring())


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_truncated_card_is_an_error_that_names_it(tmp_path_factory, data):
    store = PolicyStore(tmp_path_factory.mktemp("store"), ManualClock())
    identifier = store.save(make_policy(), ring())
    path = store.path / identifier / "card.json"
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    with pytest.raises(StoreError, match=r"card\.json"):
        store.load(identifier, ring())


def rewrite_card(store, identifier, **changes):
    path = store.path / identifier / "card.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"schema_version": 2}, "schema_version 2, this program reads 1"),
        ({"id": "other"}, "card of 'other'"),
        ({"colour": "red"}, "key 'colour'"),
        ({"kind": "network"}, "kind 'network', unknown"),
        ({"settings": {"gain": -1.0}}, "makes no policy"),
        ({"bpms": 5}, "key 'bpms'"),
    ],
)
def test_a_strange_card_is_refused(store, changes, words):
    identifier = store.save(make_policy(), ring())
    rewrite_card(store, identifier, **changes)
    with pytest.raises(StoreError, match=words):
        store.load(identifier, ring())


@pytest.mark.parametrize(
    ("tensors", "words"),
    [
        ({"response": np.ones((4, 5))}, "expected were float64"),
        ({"response": np.ones((5, 4), dtype=np.float32)}, "expected were float64"),
        ({"response": np.ones((5, 4)), "more": np.ones(2)}, "'more'"),
        ({"covariance": np.eye(4)}, "no response matrix"),
        ({"response": np.full((5, 4), np.nan)}, "not finite"),
        (None, "no safetensors file"),
    ],
)
def test_strange_tensors_under_a_matching_card_are_refused(store, tensors, words):
    identifier = store.save(make_policy(), ring())
    content = b"\x80\x04N." * 8 if tensors is None else save(tensors)  # a pickle, for once
    (store.path / identifier / "policy.safetensors").write_bytes(content)
    rewrite_card(store, identifier, tensor_sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(StoreError, match=words):
        store.load(identifier, ring())


def test_a_huge_file_is_refused_before_it_is_read(store):
    identifier = store.save(make_policy(), ring())
    for name in ("policy.safetensors", "card.json"):
        with (store.path / identifier / name).open("r+b") as file:
            file.truncate(2**40)  # sparse: costs no disk
        with pytest.raises(StoreError, match="larger than"):
            store.load(identifier, ring())


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"schema_version": 1, "activations": [{"id": "../x", "time": 0}]}']
)
def test_a_damaged_active_file_is_an_error(store, text):
    store.save(make_policy(), ring())
    (store.path / "active.json").write_text(text)
    with pytest.raises(StoreError):
        store.active()


def test_the_others_are_listed_beside_a_damaged_one(store):
    good, bad = (store.save(make_policy(seed), ring()) for seed in range(2))
    (store.path / bad / "card.json").unlink()
    with pytest.raises(StoreError, match=bad):
        store.cards()
    heard = []
    assert [card.id for card in store.cards(heard.append)] == [good]
    assert len(heard) == 1


def test_what_a_killed_writer_left_is_not_listed_and_is_swept_away(store, monkeypatch):
    def die(*_):
        raise KeyboardInterrupt  # not an OSError: like a kill, no clean-up runs

    with monkeypatch.context() as patch:
        patch.setattr(files.Path, "rename", die)
        with pytest.raises(KeyboardInterrupt):
            store.save(make_policy(), ring())
    assert len(list(store.path.glob(".unfinished-*"))) == 1
    assert store.cards() == []
    identifier = store.save(make_policy(), ring())
    assert not list(store.path.glob(".unfinished-*"))
    assert store.load(identifier, ring()).policy_id == identifier


def test_a_full_disk_is_an_error_and_leaves_nothing(store, monkeypatch):
    first = store.save(make_policy(), ring())
    store.activate(first)

    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(files.os, "fsync", full)
        with pytest.raises(StoreError, match="No space left on device"):
            store.save(make_policy(1), ring())
    assert sorted(p.name for p in store.path.iterdir()) == sorted([".lock", first, "active.json"])
    assert store.active() == first


def test_a_file_in_the_place_of_the_store_is_an_error(tmp_path):
    (tmp_path / "policies").write_text("")
    with pytest.raises(StoreError, match="cannot be used"):
        PolicyStore(tmp_path / "policies").save(make_policy(), ring())


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


def test_pruning_keeps_the_newest_and_those_last_in_force(tmp_path):
    clock = ManualClock()
    store = PolicyStore(tmp_path, clock)
    ids = []
    for seed in range(6):
        ids.append(store.save(make_policy(seed), ring()))
        clock.advance(1.0)
    for identifier in (ids[3], ids[0], ids[1]):
        store.activate(identifier)
    assert store.prune(keep=2) == [ids[2], ids[3]]
    assert [card.id for card in store.cards()] == [ids[0], ids[1], ids[4], ids[5]]
    assert store.rollback() == ids[0]
    with pytest.raises(StoreError, match="no policy was active before"):
        store.rollback()
    assert sorted(path.name for path in tmp_path.iterdir() if path.is_dir()) == sorted(
        [ids[0], ids[1], ids[4], ids[5]]
    )

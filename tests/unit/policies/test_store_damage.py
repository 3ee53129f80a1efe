"""The policy store: what is damaged, strange or half written is refused by name."""

import hashlib
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import load, save
from store_examples import make_network, make_policy, ring

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import StoreError
from orbitfb.core.files import whole
from orbitfb.policies.store.directory import PolicyStore


def test_a_missing_or_damaged_policy_is_not_activated(store):
    good, bad = (store.save(make_policy(seed), ring()) for seed in range(2))
    store.activate(good)
    (store.path / bad / "policy.safetensors").write_bytes(b"")
    for identifier in ("svd-nowhere", bad):
        with pytest.raises(StoreError):
            store.activate(identifier)
    assert store.active() == good


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
        ({"schema_version": 3}, "schema_version 3, this program reads 1 and 2"),
        ({"id": "other"}, "card of 'other'"),
        ({"colour": "red"}, "key 'colour'"),
        ({"kind": "oracle"}, "kind 'oracle', unknown"),
        ({"kind": "modal"}, "no 'modes'"),
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
        ({"response": np.ones((4, 5))}, r"expected were float64 \(5, 4\)"),
        ({"response": np.ones((5, 4), dtype=np.float32)}, "expected were float64"),
        ({"response": np.ones((5, 4)), "more": np.ones(2)}, "'more'"),
        ({"covariance": np.eye(4)}, "no 'response'"),
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
        patch.setattr(whole.Path, "rename", die)
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
        patch.setattr("os.fsync", full)
        with pytest.raises(StoreError, match="No space left on device"):
            store.save(make_policy(1), ring())
    assert sorted(p.name for p in store.path.iterdir()) == sorted([".lock", first, "active.json"])
    assert store.active() == first


def test_a_file_in_the_place_of_the_store_is_an_error(tmp_path):
    (tmp_path / "policies").write_text("")
    with pytest.raises(StoreError, match="cannot be used"):
        PolicyStore(tmp_path / "policies").save(make_policy(), ring())


@pytest.mark.parametrize(
    ("name", "tensor", "words"),
    [
        ("weight_2", np.zeros((15, 14), np.float32), r"expected were float32 \(15, 15\)"),
        ("weight_1", np.zeros((15, 5)), "expected were float32"),
        ("weight_1", np.zeros(15, np.float32), "expected were float32"),
        ("weight_1", np.zeros((61, 5), np.float32), r"expected were float32 \(60, 5\)"),
        ("weight_3", None, "no 'weight_3'"),
        ("weight_5", np.zeros((4, 4), np.float32), "'weight_5', which a policy of kind network"),
        ("weight_4", np.full((4, 15), np.nan, np.float32), "matrix 4 .* is not finite"),
    ],
)
def test_strange_weights_are_refused(store, name, tensor, words):
    identifier = store.save(make_network(), ring())
    path = store.path / identifier / "policy.safetensors"
    tensors = load(path.read_bytes())
    if tensor is None:
        del tensors[name]
    else:
        tensors[name] = tensor
    content = save(tensors)
    path.write_bytes(content)
    rewrite_card(store, identifier, tensor_sha256=hashlib.sha256(content).hexdigest())
    with pytest.raises(StoreError, match=words):
        store.load(identifier, ring())

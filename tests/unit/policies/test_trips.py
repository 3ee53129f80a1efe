"""Whose trip it is: the policy's that acted, unless the beam was lost or nothing was written."""

from types import SimpleNamespace

import numpy as np
import pytest
from store_examples import make_policy, ring

from orbitfb.core.errors import StoreError
from orbitfb.core.signals import LoopState
from orbitfb.policies.trips import TripNotes
from orbitfb.safety.interlocks import InterlockSettings


def record(state, policy, current=0.4, reason=""):
    slow = {"current": current}
    reading = None if current is None else SimpleNamespace(auxiliary=slow, by_others=None)
    return SimpleNamespace(
        state=LoopState(state),
        policy_id=policy,
        reading=reading,
        reason=reason,
        tick=1,
        setpoints=np.zeros(20),
    )


@pytest.fixture
def bad(store):
    return store.save(make_policy(), ring())


def told(store, *records):
    notes = TripNotes(store, InterlockSettings(), every=0.01)
    for entry in records:
        notes(entry)
    notes.close()
    return {name: (failure.cause, failure.reason) for name, failure in store.failures().items()}


def test_a_trip_of_a_closed_loop_is_put_on_record(store, bad):
    said = told(
        store, record("CLOSED", bad), record("TRIPPED", bad, reason="rms"), record("TRIPPED", bad)
    )
    assert said == {bad: ("tripped", "rms")}
    assert store.fault_of(bad) == "tripped the loop: rms"


def test_a_policy_that_came_in_this_very_tick_has_not_acted(store, bad):
    assert list(told(store, record("CLOSED", bad), record("TRIPPED", "svd-new"))) == [bad]


@pytest.mark.parametrize("after", [0.0, 0.2, float("nan")])
def test_a_lost_beam_is_not_the_policys_fault(store, bad, after):
    assert told(store, record("CLOSED", bad), record("TRIPPED", bad, after)) == {}


def test_what_somebody_else_moves_is_not_the_policys_fault(store, bad):
    def moved(count):
        last = record("TRIPPED", bad)
        last.reading.by_others = np.arange(20) < count
        return last

    assert told(store, record("CLOSED", bad), moved(20)) == {}
    assert list(told(store, record("CLOSED", bad), moved(1))) == [bad]


@pytest.mark.parametrize("before", ["HELD", "OPEN", "SHADOW", "TRIPPED"])
def test_a_loop_that_did_not_act_blames_nobody(store, bad, before):
    assert told(store, record(before, bad), record("TRIPPED", bad)) == {}


def test_it_is_written_once_the_store_takes_it(store, bad, monkeypatch):
    failed, attempts = type(store).failed, []

    def sometimes(self, *what):
        attempts.append(what)
        if len(attempts) < 3:
            raise StoreError("no room")
        failed(self, *what)

    monkeypatch.setattr(type(store), "failed", sometimes)
    notes = TripNotes(store, InterlockSettings(), every=0.001)
    notes(record("CLOSED", bad))
    notes(record("TRIPPED", bad, reason="rms"))
    while notes.writer.pending:
        pass
    notes.close()
    assert store.failures()[bad].reason == "rms"

"""What a running service answers: refusals that need no machine, no thread and no socket."""

from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orbitfb.app.commands import answers
from orbitfb.app.commands.answers import Remote
from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.core.errors import ControlError, StoreError
from orbitfb.core.refit import RefitReport
from orbitfb.core.signals import LoopState
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()
NOMINAL = response(RING, "x")
FIRST, SECOND, THIRD = (SvdPolicy(NOMINAL, SvdSettings(gain=gain)) for gain in (0.5, 0.4, 0.3))


class Slot:
    """The policy in force."""

    def __init__(self) -> None:
        self.current = SECOND

    def swap(self, policy: SvdPolicy) -> SvdPolicy:
        before, self.current = self.current, policy
        return before


@pytest.fixture
def store(tmp_path: Path) -> PolicyStore:
    store = PolicyStore(tmp_path)
    for policy in (FIRST, SECOND, THIRD):
        store.save(policy, RING.channels("x"))
    store.activate(FIRST.policy_id)
    store.activate(SECOND.policy_id)
    return store


def served(
    store: PolicyStore, learner: Any = None, planes: Any = "x", runner: Any = None
) -> Remote:
    parts = (runner, None, Slot(), store, learner, RING.channels(planes), Path("d/archive"), 0.1)
    return Remote(*cast(Any, parts))


def test_activate_stores_and_swaps(store: PolicyStore):
    answers = served(store)
    answer = answers({"command": "activate", "policy": THIRD.policy_id})
    assert answer == {"policy": THIRD.policy_id, "before": SECOND.policy_id}
    assert store.active() == answers.slot.current.policy_id == THIRD.policy_id


def test_closing_is_refused_where_the_measured_response_would_lose_the_beam(store: PolicyStore):
    """The policy in force is made for the optics; one BPM reads the other way round."""
    measured = NOMINAL.copy()
    measured[7] *= -1.0
    runner = SimpleNamespace(command=lambda name: _done(name), state="CLOSED", reason="")
    answers = replace(served(store, runner=runner), measured=KnownResponse(measured))
    with pytest.raises(ControlError, match=r"close refused: .* grows by 1\.\d+ per tick"):
        answers({"command": "close"})
    assert answers({"command": "open"})["state"] == "open"
    answers.measured.matrix = NOMINAL  # measured anew
    assert answers({"command": "close"})["state"] == "close"


def _done(name: str) -> Future[str]:
    future: Future[str] = Future()
    future.set_result(name)
    return future


def test_roll_back_stores_and_swaps(store: PolicyStore):
    answers = served(store)
    answer = answers({"command": "activate", "policy": None})
    assert answer == {"policy": FIRST.policy_id, "before": SECOND.policy_id}
    assert store.active() == answers.slot.current.policy_id == FIRST.policy_id
    with pytest.raises(StoreError, match="no policy was active before"):
        answers({"command": "activate", "policy": None})


@pytest.mark.parametrize("policy", [7, "nobody", "../x", ["x"], THIRD.policy_id, None])
def test_what_cannot_be_put_in_force_changes_nothing(store: PolicyStore, policy: object):
    """The last two are there, but for another ring."""
    answers = served(store, planes="y")
    with pytest.raises((StoreError, ControlError)):
        answers({"command": "activate", "policy": policy})
    assert store.active() == SECOND.policy_id
    assert answers.slot.current is SECOND


def test_a_learner_that_is_off(store: PolicyStore):
    with pytest.raises(ControlError) as caught:
        served(store)({"command": "refit"})
    assert str(caught.value) == (
        "the learner of this service is off (learn.enabled); refit from its archive: orbitfb "
        "refit --from d/archive"
    )


class Learner:
    """Gives a future that somebody else fulfils."""

    def __init__(self) -> None:
        self.future: Future[RefitReport] = Future()
        self.activate: bool | None = None

    def request(self, activate: bool) -> Future[RefitReport]:
        self.activate = activate
        return self.future


def test_a_service_that_stops_before_the_refit(store: PolicyStore):
    learner = Learner()
    learner.future.cancel()
    with pytest.raises(ControlError, match="the service stopped before the refit was made"):
        served(store, learner)({"command": "refit", "activate": "yes"})
    assert learner.activate is False  # nothing but true says yes


def test_a_refit_that_takes_too_long(store: PolicyStore, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(answers, "REFIT_TIMEOUT", 0.0)
    with pytest.raises(ControlError, match=r"the refit is not done after 0.0 s"):
        served(store, Learner())({"command": "refit"})


def test_a_command_without_a_tick_is_withdrawn(store: PolicyStore, monkeypatch: pytest.MonkeyPatch):
    """Told to have failed, it must not close the loop when the ticks come back."""
    monkeypatch.setattr(answers, "LONGEST_PATIENCE", 0.0)
    order: Future[LoopState] = Future()
    runner = SimpleNamespace(
        command=lambda name: order, state=LoopState.OPEN, reason="no orbit for 3 s"
    )
    with pytest.raises(ControlError) as caught:
        served(store, runner=runner)({"command": "close"})
    assert str(caught.value) == (
        "close: no tick came within 0 s, the command is withdrawn; the loop is OPEN: no orbit for "
        "3 s"
    )
    assert order.cancelled()


def test_a_command_that_was_carried_out(store: PolicyStore):
    order: Future[LoopState] = Future()
    order.set_result(LoopState.CLOSED)
    runner = SimpleNamespace(command=lambda name: order, reason="")
    assert served(store, runner=runner)({"command": "close"})["state"] is LoopState.CLOSED


UNSTABLE = SvdPolicy(NOMINAL, SvdSettings(gain=1.8, integral_gain=1.0))


@pytest.mark.parametrize("state", [LoopState.CLOSED, LoopState.HELD])
@pytest.mark.parametrize("failed", [False, True])
def test_what_would_run_away_or_tripped_the_loop_is_refused_in_a_closed_loop(
    store: PolicyStore, state: LoopState, failed: bool
):
    name = store.save(THIRD if failed else UNSTABLE, RING.channels("x"))
    if failed:
        store.failed(name, "tripped", "rms orbit error 1005 µm exceeds 1000 µm")
    said = r": tripped the loop: rms" if failed else r": unstable: .* grow by 1\.\d+ per tick"
    answers = served(store, runner=SimpleNamespace(state=state))
    request = {"command": "activate", "policy": name}
    with pytest.raises(ControlError, match=said) as caught:
        answers(request)
    assert f"`orbitfb policies activate {name} --force`" in str(caught.value)
    assert store.active() == SECOND.policy_id
    assert answers.slot.current is SECOND
    answer = answers({**request, "force": True})
    assert store.active() == answers.slot.current.policy_id == answer["policy"] == name
    assert answer["warning"].startswith("tripped the loop: " if failed else "unstable: ")


def test_rollback_passes_over_what_tripped_the_loop_and_force_does_not(store: PolicyStore):
    for policy in (THIRD, SECOND):
        store.activate(policy.policy_id)
    store.failed(THIRD.policy_id, "tripped", "rms")
    answers = served(store, runner=SimpleNamespace(state=LoopState.CLOSED))
    # FIRST, SECOND, THIRD, SECOND: neither to the one that failed nor to the one that is left.
    assert answers({"command": "activate", "policy": None})["policy"] == FIRST.policy_id
    for policy in (THIRD, SECOND):
        store.activate(policy.policy_id)
    answer = answers({"command": "activate", "policy": None, "force": True})
    assert answer["policy"] == THIRD.policy_id == store.active()
    assert answer["warning"] == "tripped the loop: rms"


def test_a_loop_that_is_open_takes_it_and_says_so(store: PolicyStore):
    name = store.save(UNSTABLE, RING.channels("x"))
    answers = served(store, runner=SimpleNamespace(state=LoopState.OPEN))
    answer = answers({"command": "activate", "policy": name})
    assert (answer["policy"], answer["warning"][:9]) == (name, "unstable:")

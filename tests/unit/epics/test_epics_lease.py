"""The lease: one holder, alive by its own signs, taken over only when it is stale."""

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import MachineError, OwnershipError, WriteError
from orbitfb.core.signals import Applied
from orbitfb.epics.lease.late import LateLease
from orbitfb.epics.lease.lease import LONGEST, Lease, LeaseSettings
from orbitfb.loop.machines.guarded import GuardedMachine

TIME = 4.0


class Texts:
    """Texts of an IOC; what others do happens as time goes on."""

    def __init__(self, size: int = 1) -> None:
        self.clock = ManualClock(1e9)
        self.texts = [""] * size
        self.away = False
        self.others: list[tuple[float, str]] = []
        self.written: list[str] = []

    def read(self) -> tuple[str, ...]:
        if self.away:
            raise MachineError("disconnected")
        return tuple(self.texts)

    def write(self, text: str) -> None:
        if self.away:
            raise MachineError("disconnected")
        self.texts = [text] * len(self.texts)
        self.written.append(text)

    def wait(self, seconds: float) -> bool:
        end = self.clock.monotonic() + seconds
        while self.others and self.others[0][0] <= end:
            _, text = self.others.pop(0)
            self.texts[0] = text
        self.clock.advance(seconds)
        return False

    def at(self, seconds: float, text: str) -> None:
        self.others.append((self.clock.monotonic() + seconds, text))

    def lease(self, lost=lambda _: None) -> Lease:
        return Lease(self, LeaseSettings(time=TIME), self.clock, self.wait, lost)


@pytest.fixture
def texts() -> Texts:
    return Texts()


def test_a_free_lease_is_taken_at_once(texts: Texts):
    lease = texts.lease()
    assert lease.take() == ""
    assert texts.texts[0].startswith(lease.owner) and len(texts.texts[0]) <= LONGEST
    assert lease.refusal() == ""


def test_a_live_lease_is_refused_and_left_alone(texts: Texts):
    texts.texts[0] = "ws7:12:ab:5"
    texts.at(0.9, "ws7:12:ab:6")
    begin = texts.clock.monotonic()
    with pytest.raises(OwnershipError, match=r"under the control of ws7:12:ab \(host:process"):
        texts.lease().take()
    assert texts.written == []
    assert texts.clock.monotonic() - begin < 1.2  # as soon as it is known


def test_a_stale_lease_is_taken_over_after_its_time_and_not_before(texts: Texts):
    texts.texts[0] = "ws7:12:ab:5"
    begin = texts.clock.monotonic()
    first_write = []
    write = texts.write
    texts.write = lambda text: first_write.append(texts.clock.monotonic()) or write(text)
    assert texts.lease().take() == "ws7:12:ab"
    assert TIME <= first_write[0] - begin < 1.5 * TIME


@pytest.mark.parametrize("late", [0.1, 2.0, TIME - 0.01])
def test_a_sign_of_life_at_the_last_moment_counts(texts: Texts, late: float):
    texts.texts[0] = "ws7:12:ab:5"
    texts.at(late, "ws7:12:ab:6")
    with pytest.raises(OwnershipError):
        texts.lease().take()


def test_a_lease_given_back_while_waiting_is_taken(texts: Texts):
    texts.texts[0] = "ws7:12:ab:5"
    texts.at(1.5, "")
    assert texts.lease().take() == "ws7:12:ab"


def test_of_two_that_write_at_once_the_first_gives_in(texts: Texts):
    texts.at(0.2, "ws7:12:ab:1")
    with pytest.raises(OwnershipError, match="ws7:12:ab"):
        texts.lease().take()


def test_two_of_one_process_are_two(texts: Texts):
    first, second = texts.lease(), texts.lease()
    first.take()
    texts.at(0.5, f"{first.owner}:99")
    with pytest.raises(OwnershipError):
        second.take()


def test_a_lease_of_two_planes_is_held_for_both_or_not_at_all():
    texts = Texts(size=2)
    texts.texts[1] = "ws7:12:ab:5"
    texts.others.append((texts.clock.monotonic() + 0.5, ""))
    original = texts.wait

    def wait(seconds: float) -> bool:
        texts.texts[1] = f"ws7:12:ab:{texts.clock.monotonic():.0f}"
        return original(seconds)

    texts.wait = wait
    with pytest.raises(OwnershipError, match="ws7"):
        texts.lease().take()
    assert texts.written == []


def test_who_was_asleep_does_not_write_before_it_has_looked(texts: Texts):
    """A process that stood still for the time of the lease may have a successor by then."""
    lost: list[str] = []
    lease = texts.lease(lost.append)
    lease.take()
    lease.beat()
    texts.clock.advance(0.9 * TIME)
    assert lease.refusal() == ""
    texts.clock.advance(0.2 * TIME)
    assert "is not confirmed for 4.4 s" in lease.refusal()
    texts.texts[0] = "ws7:12:ab:5"
    lease.beat()
    assert "reads ws7:12:ab:5, which is not of this controller" in lease.refusal()
    texts.texts[0] = "ws7:12:ab:6"
    lease.beat()
    assert lost == ["ws7:12:ab"]
    assert lease.refusal().startswith("the lease of the machine was taken by ws7:12:ab; ")
    lease.beat()
    lease.release()
    assert lost == ["ws7:12:ab"] and texts.texts == ["ws7:12:ab:6"]


def test_a_text_that_stands_still_is_taken_back_and_nothing_is_written_meanwhile(texts: Texts):
    """An operator typed it, or the IOC's autosave brought an old one back."""
    lost: list[str] = []
    lease = texts.lease(lost.append)
    lease.take()
    texts.texts[0] = "who are you"
    for _ in range(4):
        lease.beat()
        assert "reads who are you" in lease.refusal()
        assert texts.texts == ["who are you"]
        texts.clock.advance(TIME / 4)
    lease.beat()
    assert texts.texts[0].startswith(lease.owner)
    assert lease.refusal() != ""  # another may have written at the same time
    texts.clock.advance(TIME / 4)
    lease.beat()
    assert lease.refusal() == "" and lost == []


def test_a_network_that_is_gone_stops_the_writing_until_it_is_back(texts: Texts):
    lease = texts.lease()
    lease.take()
    texts.away = True
    texts.clock.advance(TIME)
    lease.beat()
    assert lease.refusal().endswith(": disconnected")
    texts.away, texts.texts = False, [""]  # the IOC came back without it
    lease.beat()
    assert lease.refusal() == "" and texts.texts[0].startswith(lease.owner)


def test_it_grows_and_is_given_back(texts: Texts):
    lease = texts.lease()
    lease.take()
    seen = {texts.texts[0]}
    for _ in range(3):
        lease.beat()
        seen.add(texts.texts[0])
    assert len(seen) == 4
    lease.release()
    assert texts.texts == [""]


def test_the_names_of_the_planes():
    assert LeaseSettings().pvs("xy") == ("SR:FB{Lease:X}Owner-SP", "SR:FB{Lease:Y}Owner-SP")
    assert LeaseSettings(pv="A").pvs("xy") == ("A",)
    assert LeaseSettings(pv="").pvs("x") == ()


class Machine:
    def __init__(self) -> None:
        self.writes: list[np.ndarray] = []

    def write(self, setpoints, which=None):
        self.writes.append(setpoints)
        return Applied(setpoints, 0.0, 0.0)


def test_a_guarded_machine_is_not_written_to_while_there_is_a_reason():
    machine, reasons = Machine(), ["the lease is gone", ""]
    guarded = GuardedMachine(machine, lambda: reasons.pop(0))
    with pytest.raises(WriteError, match="the lease is gone; nothing was sent"):
        guarded.write(np.ones(2))
    assert machine.writes == []
    guarded.write(np.ones(2))
    assert len(machine.writes) == 1


class Late:
    """A lease that a machine gets only while the service runs."""

    def __init__(self, texts: Texts) -> None:
        self.texts, self.missing = texts, ["SR:LEASE"]
        self.lost: list[str] = []
        self.taken: list[str] = []
        settings = LeaseSettings(time=TIME)
        self.lease = LateLease(
            texts,
            settings,
            texts.clock,
            texts.wait,
            self.lost.append,
            lambda: self.missing,
            self.taken.append,
        )


def test_a_lease_that_comes_late_is_taken(texts: Texts):
    late = Late(texts)
    late.lease.beat()
    assert late.lease.refusal() == "" and late.lease.owner == "" and not texts.written
    late.missing.clear()
    late.lease.beat()
    assert late.taken == [""] and late.lease.refusal() == ""
    assert texts.texts[0].startswith(late.lease.owner)
    late.lease.beat()
    assert texts.texts[0].endswith(":2")
    late.lease.release()
    assert texts.texts == [""]


def test_a_lease_that_comes_late_and_is_held_ends_the_control(texts: Texts):
    late = Late(texts)
    late.missing.clear()
    texts.texts[0] = "other:1:ab:7"
    texts.at(1.5, "other:1:ab:8")
    late.lease.beat()
    assert late.lost == ["other:1:ab"] and not late.taken and not texts.written
    assert late.lease.refusal().startswith("the lease of the machine was taken by other:1:ab; ")
    late.lease.release()
    assert texts.texts == ["other:1:ab:8"]


def test_nothing_is_written_while_a_late_lease_cannot_be_read(texts: Texts):
    late = Late(texts)
    late.missing.clear()
    texts.away = True
    late.lease.beat()
    assert late.lease.refusal() == (
        "the lease of the machine has appeared; who holds it is being asked"
    )
    texts.away = False
    late.lease.beat()
    assert late.taken == [""] and late.lease.refusal() == ""

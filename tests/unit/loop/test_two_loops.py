"""Two loops on one ring without a lease: each sees the other's puts, and one gives way."""

from dataclasses import replace

import numpy as np
import pytest
from scripted import PERIOD, RESPONSE, M, N, ScriptedMachine, new_clock

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.epics.setpoints.put_watch import PutWatch
from orbitfb.loop.machines.guarded import GuardedMachine
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

CLOSED, HELD, OPEN, TRIPPED = LoopState.CLOSED, LoopState.HELD, LoopState.OPEN, LoopState.TRIPPED


class Ring:
    """Setpoints that several clients write; each hears all that is put, as monitors tell it."""

    def __init__(self):
        self.clock, self.watches = new_clock(), []
        self.inside = np.zeros(M)

    def put(self, setpoints, which):
        self.inside = np.where(which, setpoints, self.inside)
        for watch in self.watches:
            watch.records["value"][:] = self.inside
            for index in np.flatnonzero(which).tolist():
                watch.heard(index)


class Client(ScriptedMachine):
    """One controller's view of the ring."""

    def __init__(self, ring, seed):
        super().__init__(ring.clock, seed)
        self.ring, self.watch = ring, PutWatch(M)
        ring.watches.append(self.watch)
        for index in range(M):
            self.watch.heard(index)

    def read(self, timeout):
        self.inside = self.ring.inside
        return replace(super().read(timeout), by_others=self.watch.take())

    def setpoints(self):
        self.inside = self.ring.inside
        return super().setpoints()

    def write(self, setpoints, which=None):
        which = np.ones(M, dtype=bool) if which is None else which
        self.watch.sends(setpoints, which)
        applied = super().write(setpoints, which)
        self.ring.put(setpoints, which)
        return applied


def loop_on(ring, seed, start=CLOSED, refusal=lambda: ""):
    machine = Client(ring, seed)
    return Runner(
        GuardedMachine(machine, refusal),
        PolicySlot(SvdPolicy(RESPONSE, SvdSettings(gain=0.3))),
        LoopSettings(rate_hz=1 / PERIOD, ramp=0.0, proving=2),
        LimitSettings(setpoint=5.0, change_per_tick=5.0),
        InterlockSettings(divergence_ticks=1000, answer_reach=None),
        np.zeros(N),
        machine.clock,
        start=start,
        random=np.random.default_rng(seed),
    )


def states(loops, ticks):
    for _ in range(ticks):
        for loop in loops:
            loop.step()
    return [loop.state for loop in loops]


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 6))]
)
def test_of_two_that_close_at_once_one_opens_and_says_why(seed):
    ring = Ring()
    loops = [loop_on(ring, 2 * seed), loop_on(ring, 2 * seed + 1)]
    for loop in loops:
        loop.step()
    assert states(loops, 200).count(CLOSED) == 1
    [other] = [loop for loop in loops if loop.state is not CLOSED]
    assert other.state is TRIPPED
    assert "as a second controller does: COR0, COR1" in other.reason
    assert states(loops, 100).count(CLOSED) == 1  # and the one that stays, stays


def test_one_that_comes_later_does_not_close(seed=3):
    ring = Ring()
    first = loop_on(ring, seed)
    assert states([first], 20) == [CLOSED]
    second = loop_on(ring, seed + 1)
    loops = [first, second]
    assert states(loops, 5) == [CLOSED, HELD]
    assert "somebody else moves 4 of 4 setpoints" in second.reason
    assert states(loops, 20) == [CLOSED, TRIPPED]
    second.command("reset")
    states(loops, 3)
    closing = second.command("close")
    states(loops, 2)
    with pytest.raises(ControlError, match="as a second controller does"):
        closing.result(0)
    first.command("open")
    states(loops, 25)
    second.command("close")
    assert states(loops, 5) == [OPEN, CLOSED]


def test_one_whose_lease_is_gone_holds_and_does_not_call_the_owner_a_second_controller():
    ring, refusals = Ring(), [""]
    stopped = loop_on(ring, 3, refusal=lambda: refusals[0])
    assert states([stopped], 20) == [CLOSED]
    owner = loop_on(ring, 4)
    refusals[0] = "the lease of the machine is not confirmed for 5 s"  # its process stood still
    states([owner], 20)
    assert owner.state is CLOSED
    assert states([stopped, owner], 50) == [HELD, CLOSED]
    refusals[0] = ""  # both hold it, which the lease excludes
    assert states([owner, stopped], 50).count(TRIPPED) == 1


def test_a_loop_that_only_looks_may_look_on():
    ring = Ring()
    first, shadow = loop_on(ring, 1), loop_on(ring, 2, LoopState.SHADOW)
    assert states([first, shadow], 60) == [CLOSED, LoopState.SHADOW]
    assert shadow.step().policy_id


def test_alone_nobody_is_seen():
    ring = Ring()
    loop = loop_on(ring, 1)
    states([loop], 100)
    assert (loop.state, loop.reason) == (CLOSED, "")

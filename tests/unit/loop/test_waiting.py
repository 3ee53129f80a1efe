"""Puts that are late: one orbit error is corrected once, and that costs nothing otherwise."""

from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scripted import PERIOD, RESPONSE, InversePolicy, M, N, ScriptedMachine, new_clock

from orbitfb.core.signals import Applied, LoopState, Orbit, Reading
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.loop.timing.waiting import too_early
from orbitfb.safety.arrival import RARE, Sent
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


class LatePuts(ScriptedMachine):
    """A machine at which puts act some orbits late, and its readbacks with them."""

    def __init__(self):
        super().__init__(new_clock())
        self.late, self.on_the_way = 0, deque()

    def read(self, timeout):
        while self.on_the_way and self.on_the_way[0][0] <= self.clock.monotonic() + 1e-9:
            self.inside = self.on_the_way.popleft()[1]
        return super().read(timeout)

    def setpoints(self):
        self.asked += 1  # whose answer comes behind what is on the way
        return (self.on_the_way[-1][1] if self.on_the_way else self.inside).copy()

    def write(self, setpoints, which=None):
        self.writes.append(setpoints.copy())
        due = self.clock.monotonic() + self.late * PERIOD
        before = self.on_the_way[-1][1] if self.on_the_way else self.inside
        then = setpoints if which is None else np.where(which, setpoints, before)
        self.on_the_way.append((due, then.copy()))
        return Applied(setpoints, self.clock.wall(), self.clock.monotonic())


def at_rest(machine, policy):
    """Give a closed loop before its first tick."""
    return Runner(
        machine,
        PolicySlot(policy),
        LoopSettings(ramp=0.0),
        LimitSettings(setpoint=50.0, change_per_tick=50.0),
        InterlockSettings(divergence_factor=1000.0, prediction_ticks=0, answer_reach=None),
        np.zeros(N),
        machine.clock,
        start=LoopState.CLOSED,
    )


def closed(machine, policy):
    runner = at_rest(machine, policy)
    for _ in range(60):
        runner.step()
    return runner


@pytest.fixture
def loop():
    machine = LatePuts()
    runner = at_rest(machine, InversePolicy(gain=0.9))
    records = [runner.step() for _ in range(60)]
    assert not any(record.held_back for record in records)
    assert sum(np.isfinite(record.written) for record in records) == len(machine.writes) == 58
    return machine, runner


class Beating(ScriptedMachine):
    """A machine whose orbits come at their own pace, and wait while the loop is busy."""

    def __init__(self):
        super().__init__(new_clock())
        self.history, self.given = [(self.clock.monotonic(), self.inside)], 0

    def read(self, timeout):
        start = self.history[0][0]
        newest = int((self.clock.monotonic() - start) / PERIOD + 1e-6)
        self.given = max(newest, self.given + 1)
        taken = start + self.given * PERIOD
        self.clock.advance(max(0.0, taken - self.clock.monotonic()))
        inside = [setpoints for since, setpoints in self.history if since <= taken + 1e-9][-1]
        noise = 1e-9 * self._random.standard_normal(N)
        position = RESPONSE @ inside + self.disturbance + noise
        late = self.clock.monotonic() - taken
        orbit = Orbit(position, np.ones(N, dtype=bool), self.clock.wall() - late)
        return Reading(orbit, inside.copy(), {"current": self.current}, taken)

    def write(self, setpoints, which=None):
        applied = super().write(setpoints, which)
        self.history.append((self.clock.monotonic(), self.inside.copy()))
        return applied


class Busy(InversePolicy):
    """Takes so long that the next orbit comes before it has decided."""

    def __init__(self, clock, takes):
        super().__init__(gain=0.9)
        self.clock, self.takes = clock, takes

    def act(self, error, valid, state):
        self.clock.advance(self.takes)
        return super().act(error, valid, state)


@pytest.mark.parametrize(("takes", "missed"), [(0.02, 0), (0.15, 1), (0.18, 1)])
def test_an_orbit_that_came_before_the_last_change_left_is_passed_over(takes, missed):
    machine = Beating()
    runner = at_rest(machine, Busy(machine.clock, takes))
    machine.disturbance = correctable(2.0)
    records = [runner.step() for _ in range(12)]
    first = next(i for i, record in enumerate(records) if np.isfinite(record.written))
    errors = [rms(record) for record in records[first : first + 4]]
    np.testing.assert_allclose(errors[1:], errors[0] * 0.1 ** np.arange(1, 4), rtol=0.05)
    assert not any(record.held_back for record in records)
    assert [record.missed for record in records[first + 1 :]] == [missed] * (11 - first)


def correctable(scale):
    return scale * RESPONSE @ np.ones(M)


def rms_of(orbit):
    return np.sqrt(np.mean(orbit**2))


def rms(record):
    return np.sqrt(np.mean(record.reading.orbit.position**2))


@pytest.mark.parametrize("late", [1, 2, 3])
def test_one_error_is_corrected_once_while_puts_are_late(loop, late):
    machine, runner = loop
    machine.late, machine.disturbance = late, correctable(2.0)
    first = runner.step()
    assert np.isfinite(first.written) and not first.held_back
    for _ in range(late):
        record = runner.step()
        assert record.held_back and np.isnan(record.written) and not record.applied.any()
        assert record.state is LoopState.CLOSED
        assert "held back: 0% of the last change shows" in record.reason
    machine.late = 0
    record = runner.step()
    assert not record.held_back and not record.reason
    assert rms(record) < 0.2 * rms(first)


def test_orbits_that_come_in_a_burst_are_not_each_corrected(loop):
    machine, runner = loop
    machine.late, machine.disturbance = 3, correctable(2.0)
    errors = [rms(runner.step()) for _ in range(12)]
    assert max(errors) <= errors[0] * 1.01


@pytest.mark.parametrize("size", [0.05, 2.0])
def test_a_change_that_was_lost_is_found_out_by_asking(loop, size):
    machine, runner = loop
    machine.late, machine.disturbance = 10**6, correctable(size)
    runner.step()
    machine.late = 0
    machine.on_the_way.clear()
    asked = machine.asked
    records = [runner.step() for _ in range(3)]
    assert all(record.held_back for record in records) and machine.asked == asked + 1
    assert records[-1].state is (LoopState.HELD if size > 1.0 else LoopState.CLOSED)
    assert "setpoints were moved: COR" in records[-1].reason or size < 1.0
    for _ in range(8):
        record = runner.step()
    assert record.state is LoopState.CLOSED and rms(record) < 1e-6


def test_a_loop_at_a_machine_that_is_late_from_now_on_goes_on_more_slowly(loop):
    machine, runner = loop
    machine.late = 1
    records = [runner.step() for _ in range(100)]
    assert 40 < sum(record.held_back for record in records) < 60
    assert sum(np.isfinite(record.written) for record in records) > 40


class Full:
    """A damped inverse that says what it was made for."""

    policy_id, response = "full", RESPONSE

    def initial_state(self):
        return None

    def act(self, error, valid, state):
        return -0.9 * np.linalg.pinv(RESPONSE) @ np.where(valid, error, 0.0), state


@pytest.mark.parametrize("late", [1, 2])
def test_five_late_changes_in_a_row_do_not_have_each_error_corrected_again_and_again(late):
    """Were they no longer waited for, the loop would drive the orbit away."""
    machine = LatePuts()
    runner = closed(machine, Full())
    machine.late = late
    for size in (2.0, 0.0, 2.0, 0.0):
        machine.disturbance = correctable(size)
        errors = [rms(runner.step()) for _ in range(60)]
        assert max(errors) < 1.05 * rms_of(correctable(2.0))
        assert np.mean(errors[20:]) < 1e-6
        assert runner.state is LoopState.CLOSED


def test_readbacks_that_have_become_slow_do_not_hold_back_what_the_orbit_shows():
    machine = LatePuts()
    runner = closed(machine, Full())
    plain, shown = machine.read, deque(maxlen=2)

    def read(timeout):
        reading = plain(timeout)
        shown.append(reading.readback)
        return replace(reading, readback=shown[0])

    machine.read = read
    held = []
    for size in (2.0, 0.0) * 8:
        machine.disturbance = correctable(size)
        held.append([runner.step().held_back for _ in range(4)])
    assert np.sum(held[:3]) > 0  # while it seems rare
    assert not np.any([row[1] for row in held[8:]])  # the orbit after a large change


def test_readbacks_of_before_the_orbit_hold_nobody_back(loop):
    machine, runner = loop
    plain, all_of_them = machine.read, np.ones(M, dtype=bool)
    machine.read = lambda timeout: replace(plain(timeout), behind=all_of_them)
    machine.late = 1
    assert not any(runner.step().held_back for _ in range(30))


def test_nothing_is_waited_for_once_the_setpoints_were_moved_or_the_loop_opened(loop):
    machine, runner = loop
    machine.late, machine.disturbance = 5, correctable(2.0)
    runner.step()
    runner.command("open")
    runner.step()
    machine.late = 0
    for _ in range(6):
        runner.step()
    runner.command("close")
    assert not runner.step().held_back


@pytest.mark.parametrize(
    ("shows", "late", "early"), [(0.0, 0.0, True), (1.0, 0.0, False), (0.0, RARE, False)]
)
def test_an_orbit_of_before_the_last_change_is_known_where_changes_are_in_time(shows, late, early):
    change = np.full(M, 0.1)
    sent = Sent(change=change, late=late, prompt=late == 0.0)
    memory = SimpleNamespace(sent=sent, setpoints=change)
    reading = SimpleNamespace(readback=shows * change, away=None, behind=None)
    assert too_early(memory, reading, np.ones(M, dtype=bool)) is early

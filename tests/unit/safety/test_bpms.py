"""Readings that look like numbers and must not be believed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.safety.bpms import BpmMemory, Flaw, bpm_quota, longest_run, screen
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.repeating import Habit
from orbitfb.safety.verdict import Action

S = InterlockSettings(bpm_proving=3)
N = 12


class Ring:
    """Twelve BPMs in a slight breeze."""

    def __init__(self, settings=S, planes=1):
        self.settings, self.planes = settings, planes
        self.memory = BpmMemory.first(N, settings)
        self._random = np.random.default_rng(4)

    def see(self, bad=None, move=0.0, latching=True):
        position = move + 1e-6 * self._random.standard_normal(N)
        for index, value in (bad or {}).items():
            position[index] = self.memory.last[index] if value == "same" else value
        ok = np.ones(N, dtype=bool)
        flaws, self.memory = screen(
            position, position, ok, self.memory, self.settings, self.planes, latching
        )
        return [Flaw(int(flaw)) for flaw in flaws]


def test_a_nan_bpm_is_not_read_as_on_reference():
    ring = Ring()
    ring.see()
    assert ring.see({3: np.nan})[3] is Flaw.INVALID
    assert ring.see({3: 0.0})[3] is Flaw.ZERO
    assert Ring(InterlockSettings(bpm_zero=False)).see({3: 0.0})[3] is Flaw.NONE


def test_a_frozen_bpm_is_left_out_and_proves_itself_before_it_counts_again():
    ring = Ring()
    seen = [ring.see({5: "same"} if tick in (2, 3) else None)[5] for tick in range(8)]
    assert seen == [Flaw.NONE] * 3 + [Flaw.FROZEN] + [Flaw.PROVING] * 2 + [Flaw.NONE] * 2


def test_a_whole_orbit_that_repeats_itself_is_not_twelve_frozen_bpms():
    ring = Ring()
    ring.see()
    same = dict.fromkeys(range(N), "same")
    for _ in range(4):
        assert set(ring.see(same)) == {Flaw.NONE}


def test_a_bpm_that_jumps_alone_stays_out_until_it_is_back_or_the_loop_was_opened():
    ring = Ring()
    ring.see()
    for tick in range(20):
        assert ring.see({2: 1e-3 + tick * 1e-6})[2] is Flaw.JUMP
    assert [ring.see()[2] for _ in range(3)] == [Flaw.PROVING, Flaw.PROVING, Flaw.NONE]
    ring.see({2: 1e-3})
    ring.see({2: np.nan})  # what goes away in between is not forgiven
    assert ring.see({2: 1e-3})[2] is Flaw.JUMP
    ring.see({2: 1.0001e-3}, latching=False)
    for tick in range(3):
        ring.see({2: 1e-3 + tick * 1e-6})
    assert ring.see({2: 1e-3})[2] is Flaw.NONE


def test_a_beam_that_is_kicked_is_no_jump_of_its_bpms():
    ring = Ring()
    ring.see()
    assert set(ring.see(move=1e-3)) == {Flaw.NONE}
    assert ring.see({0: 9e-3}, move=1e-3)[0] is Flaw.JUMP
    two = Ring(planes=2)  # a kick in x alone leaves y where it is
    two.see()
    kicked = {index: 1e-3 * (1 + index) for index in range(6)}
    assert set(two.see(kicked)) == {Flaw.NONE}


@pytest.mark.parametrize("planes", [1, 2])
def test_bpms_that_come_back_late_from_an_outage_did_not_jump(planes):
    ring = Ring(planes=planes)
    ring.see()
    late = dict.fromkeys(range(N - 3, N), np.nan)
    for _ in range(3):
        ring.see(dict.fromkeys(range(N), np.nan))
    ring.see(late, move=1e-3)  # the beam is elsewhere when the IOC is back
    ring.see(late | {1: 9e-3}, move=1e-3)
    for tick in range(4):
        flaws = ring.see({1: 9e-3 + tick * 1e-6, N - 1: 99e-3 + tick * 1e-6}, move=1e-3)
        assert flaws[1] is flaws[N - 1] is Flaw.JUMP
    assert {flaws[index] for index in (0, *range(2, N - 1))} <= {Flaw.NONE, Flaw.PROVING}
    for _ in range(3):
        flaws = ring.see(move=1e-3)
    assert set(flaws) == {Flaw.NONE}


@given(st.lists(st.booleans(), min_size=1, max_size=40))
def test_the_longest_run_agrees_with_walking_twice_round_the_ring(bad):
    longest = run = 0
    for each in bad * 2:
        run = run + 1 if each else 0
        longest = max(longest, run)
    assert longest_run(np.array(bad)) == min(longest, len(bad))


@pytest.mark.parametrize(
    ("bad", "planes", "action"),
    [((0, 1), 1, "WARN"), ((0, 1, 11), 1, "HOLD"), ((5, 6, 7), 2, "WARN"), ((6, 7, 11), 2, "HOLD")],
)
def test_neighbours_are_counted_round_the_ring_and_plane_by_plane(bad, planes, action):
    valid = np.ones(N, dtype=bool)
    valid[list(bad)] = False
    said = bpm_quota(valid, S, planes=planes)
    assert said.action is Action[action]


@given(st.lists(st.lists(st.sampled_from([0.0, np.nan, np.inf, 1e-6, -3e-6, 1e-3, 5.0]), min_size=4,
                         max_size=4), min_size=1, max_size=12))  # fmt: skip
def test_nothing_that_is_not_finite_or_nought_is_ever_believed(orbits):
    memory, ok = BpmMemory.first(4, S), np.ones(4, dtype=bool)
    for position in map(np.array, orbits):
        coarse = (memory.habit or Habit.none(4)).is_coarse
        flaws, memory = screen(position, position, ok, memory, S)
        assert np.isfinite(position[flaws == 0]).all()
        assert (position[(flaws == 0) & ~coarse] != 0).all()
        assert ((memory.good >= 0) & (memory.good <= S.bpm_proving)).all()


@pytest.mark.parametrize("flaw", [Flaw.JUMP, Flaw.SILENT])
def test_a_hold_that_only_an_operator_ends_says_so(flaw):
    valid, flaws = np.ones(180, bool), np.zeros(180, np.int8)
    valid[3:6], flaws[3:6] = False, flaw
    assert "count again after open and close" in bpm_quota(valid, S, flaws=flaws).reason
    flaws[3:6] = Flaw.ZERO
    assert "open and close" not in bpm_quota(valid, S, flaws=flaws).reason

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.core.signals import Orbit
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.verdict import Action
from orbitfb.safety.watch import Growth, LastOrbit, Rise, divergence, readback, repeated, rising

S = InterlockSettings(divergence_ticks=4, divergence_factor=2.0, divergence_floor=5e-6)
NAN = float("nan")


def feed(values, settings=S):
    memory, actions = Growth(), []
    for rms in values:
        verdict, memory = divergence(rms, memory, settings)
        actions.append(verdict.action)
    return actions


def test_steady_growth_by_the_factor_above_the_floor_trips():
    assert feed([10e-6, 12e-6, 15e-6, 18e-6, 21e-6])[-1] is Action.TRIP


def test_growth_that_is_short_small_or_in_the_noise_does_not_trip():
    assert Action.TRIP not in feed([10e-6, 20e-6, 40e-6, 80e-6, 79e-6, 90e-6])
    assert Action.TRIP not in feed([10e-6, 11e-6, 12e-6, 13e-6, 14e-6, 15e-6])
    assert Action.TRIP not in feed([0.1e-6, 0.2e-6, 0.4e-6, 1e-6, 3e-6, 5e-6])


def test_a_kick_after_a_few_rises_of_the_noise_is_no_divergence():
    noise = [0.20e-6, 0.21e-6, 0.22e-6, 0.23e-6, 0.24e-6]
    assert Action.TRIP not in feed([*noise, 50e-6, 30e-6])
    assert feed([*noise, 0.5e-6, 1e-6, 3e-6, 10e-6])[-1] is Action.TRIP  # it diverges from there


def test_an_rms_that_is_not_a_number_does_not_end_the_growth():
    assert feed([10e-6, 12e-6, NAN, 18e-6, 25e-6])[-1] is Action.TRIP
    assert feed([10e-6, NAN, NAN, NAN, NAN])[-1] is Action.TRIP


@given(st.lists(st.floats(0, 1e-3), max_size=30))
def test_divergence_agrees_with_looking_back_over_the_whole_list(values):
    def least(before):
        return before if before > 5e-6 else before * 2.0 ** (1 / 4)

    actions = feed(values)
    for end in range(len(values)):
        begin = end
        while begin > 0 and values[begin] > least(values[begin - 1]):
            begin -= 1
        grown = end - begin >= 4 and values[end] > 5e-6 and values[end] >= 2 * values[begin]
        assert (actions[end] is Action.TRIP) == grown


@pytest.mark.parametrize(
    ("rates", "trips"),
    [
        ([0.6e-3] * 5, True),
        ([0.4e-3] * 5, False),
        ([0.0, -5.0, 0.0], False),
        ([0.4e-3, 2e-3], True),
    ],
)
def test_only_a_growth_beyond_the_rate_trips(rates, trips):
    """In µm per second, over some seconds, at whatever rate the orbits come."""
    for hertz in (5, 100):
        rms, time, memory, actions = 1e-3, 0.0, Rise(), set()
        for rate in rates:
            for _ in range(hertz):
                rms, time = max(rms + rate / hertz, 0.0), time + 1.0 / hertz
                verdict, memory = rising(rms, time, memory, S)
                actions.add(verdict.action)
        assert (Action.TRIP in actions) == trips
    assert rising(1.0, 0.0, Rise(), S)[0].action is Action.OK  # the first is no growth
    off = InterlockSettings(distortion_rate=None)
    assert rising(1.0, 1.0, Rise(0.0, 0.0), off)[0].action is Action.OK


def orbit(values, time):
    position = np.array(values, dtype=float)
    return Orbit(position, np.isfinite(position), time)


def see(orbits, settings=S):
    memory, actions = LastOrbit(), []
    for one in orbits:
        verdict, memory = repeated(one, one.valid, memory, settings)
        actions.append(verdict.action)
    return actions


def test_an_orbit_that_is_not_newer_is_skipped_and_one_step_back_costs_one_orbit():
    orbits = [orbit([1, 2], 10.0), orbit([1, 3], 10.0), orbit([2, 2], 5.0), orbit([2, 3], 5.1)]
    assert see(orbits) == [Action.OK, Action.SKIP, Action.SKIP, Action.OK]
    assert see([orbit([1, 2], NAN)]) == [Action.SKIP]


def test_frozen_readings_with_new_stamps_are_skipped():
    same = [orbit([1, NAN], t) for t in (1.0, 2.0, 3.0)]
    assert see([*same, orbit([1.5, NAN], 4.0)]) == [
        Action.OK,
        Action.SKIP,
        Action.SKIP,
        Action.OK,
    ]
    later = InterlockSettings(frozen_ticks=2)
    assert see(same, later) == [Action.OK, Action.OK, Action.SKIP]
    never = InterlockSettings(frozen_ticks=0)
    assert see(same, never) == [Action.OK] * 3


def test_a_corrector_that_does_not_follow_holds_after_some_ticks_in_a_row():
    counts = np.zeros(3, dtype=np.int64)
    off = np.array([False, True, False])
    for expected in (Action.WARN, Action.WARN, Action.HOLD):
        verdict, counts = readback(off, counts, 3, ("a", "b", "c"))
        assert verdict.action is expected
        assert "b" in verdict.reason
    verdict, counts = readback(~off & False, counts, 3)
    assert verdict.action is Action.OK
    assert not counts.any()

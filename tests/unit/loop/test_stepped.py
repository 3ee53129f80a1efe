"""Setpoints that hold steps only: rounded here, the remainder carried, never beyond a limit."""

import numpy as np
import pytest
from scripted import RESPONSE, M, ScriptedMachine, new_clock

from orbitfb.loop.machines.stepped import SteppedMachine, rounding_told, stepped

NONE = np.full((M, 2), np.nan)


def machine(step, limit=17.5, drive=NONE):
    inside = ScriptedMachine(new_clock())
    return inside, SteppedMachine(inside, np.array(step, float), limit, lambda: drive)


def test_what_is_sent_is_on_the_grid_and_said():
    inside, coarse = machine([1.0, 0.5, 0.0, 1e-3])
    applied = coarse.write(np.array([0.7, 0.7, 0.7, 0.00049]))
    np.testing.assert_array_equal(applied.setpoints, [1.0, 0.5, 0.7, 0.0])
    np.testing.assert_array_equal(inside.inside, applied.setpoints)


def test_small_changes_add_up_instead_of_being_lost():
    inside, coarse = machine([1.0] * M)
    at = np.zeros(M)
    for _ in range(100):
        at = coarse.write(at + 0.13).setpoints
    assert np.abs(inside.inside - 13.0).max() <= 0.5 + 1e-9


def test_a_value_on_the_grid_is_sent_as_it_is_whatever_was_carried():
    inside, coarse = machine([1.0] * M)
    coarse.write(np.full(M, 0.49))
    coarse.write(np.full(M, 3.0))
    np.testing.assert_array_equal(inside.inside, np.full(M, 3.0))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_rounding_leads_beyond_no_limit(sign):
    drive = np.full((M, 2), np.nan)
    drive[1] = -2.6, 2.6
    inside, coarse = machine([1.0] * M, drive=drive)
    for _ in range(3):
        coarse.write(np.array([17.5, 2.6, 0.0, 17.4]) * sign)
        np.testing.assert_array_equal(inside.inside * sign, [17.0, 2.0, 0.0, 17.0])


def test_those_that_are_not_put_keep_what_they_carry():
    inside, coarse = machine([1.0] * M)
    coarse.write(np.full(M, 0.4), np.array([True, True, False, False]))
    coarse.write(np.full(M, 0.2))
    np.testing.assert_array_equal(inside.inside, [1.0, 1.0, 0.0, 0.0])


def test_it_is_told_what_rounding_does_and_other_machines_stay_as_they_are():
    inside, _ = machine([0.0] * M)
    assert stepped(inside, np.zeros(M), 17.5, lambda: NONE) is inside
    assert rounding_told(np.zeros(M), RESPONSE, ("A",) * M) == ""
    told = rounding_told(np.array([0, 1.0, 0, 0]), RESPONSE, ("A", "B", "C", "D"))
    rms = np.sqrt(np.mean(RESPONSE[:, 1] ** 2) / 12) * 1e6
    assert told.startswith("1 of 4 setpoints hold steps only, of up to 1 A: B; ")
    assert f"by about {rms:.3g} µm rms" in told

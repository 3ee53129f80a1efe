"""Averages of orbits, and a dead band: corrected less often, and not at all what is small."""

from dataclasses import replace

import numpy as np
import pytest
from scripted import RESPONSE, InversePolicy, M, N
from test_runner import Bench

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Channels, LoopState
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.averaging import restrain
from orbitfb.loop.memory import Gathered
from orbitfb.loop.tick import Checked
from orbitfb.safety.verdict import FINE

LAW = -0.5 * np.linalg.pinv(RESPONSE)
QUIET = {"divergence_ticks": 1000}


def adjust(bench, **changes):
    bench.runner.adjust(replace(bench.runner.adjustments, **changes))


def test_it_corrects_once_in_so_many_orbits_and_by_their_mean():
    bench = Bench(interlocks=QUIET, average=4)
    bench.machine.disturbance = RESPONSE @ np.array([0.5, -0.3, 0.2, 0.1])
    bench.close()
    for _ in range(19):
        bench.step()
    moved = [record for record in bench.records if record.applied.any()]
    assert [record.tick for record in moved] == [3, 7, 11, 15, 19]
    for last in moved[1:]:
        these = bench.records[last.tick - 3 : last.tick + 1]
        mean = np.mean([record.reading.orbit.position for record in these], axis=0)
        np.testing.assert_allclose(last.applied, LAW @ mean, atol=1e-12)
    assert bench.runner.state is LoopState.CLOSED
    rms = np.sqrt(np.mean(bench.records[-1].reading.orbit.position ** 2))
    first = np.sqrt(np.mean(bench.records[0].reading.orbit.position ** 2))
    assert rms < 0.1 * first


def test_closing_begins_a_new_average():
    bench = Bench(interlocks=QUIET, average=4).close()
    bench.step()
    bench.runner.command("open")
    bench.step()
    bench.close()
    first = len(bench.records) - 1
    for _ in range(3):
        bench.step()
    assert [record.applied.any() for record in bench.records[first:]] == [False] * 3 + [True]


def test_a_policy_keeps_no_state_of_ticks_that_do_not_correct():
    class Counting(InversePolicy):
        pass

    policy = Counting()
    bench = Bench(policy, interlocks=QUIET, average=3).close()
    for _ in range(8):
        bench.step()
    assert bench.runner._engine.memory.policy_state == 3  # of nine ticks


def test_within_the_dead_band_nothing_moves():
    bench = Bench(interlocks=QUIET, dead_band=5e-6)
    bench.machine.disturbance = np.full(N, 3e-6)
    bench.close()
    for _ in range(5):
        assert not bench.step().applied.any()
    bench.machine.disturbance = np.full(N, 40e-6)
    assert bench.step().applied.any()
    adjust(bench, dead_band=(100e-6,))
    assert not bench.step().applied.any()
    adjust(bench, dead_band=())
    assert bench.step().applied.any()


def two_planes(x, y, valid=None):
    error = np.concatenate([np.full(2, x), np.full(2, y)])
    valid = np.ones(4, dtype=bool) if valid is None else valid
    none = np.zeros(2, dtype=bool)
    error = np.where(valid, error, 0.0)
    memory = None  # not looked at
    return Checked(error, valid, 0.0, none, FINE, FINE, memory)


NAMES = Channels("xy", ("A", "B") * 2, ("C",) * 2, ("a",) * 4, ("c",) * 2, ("r",) * 2)


@pytest.mark.parametrize(
    ("x", "y", "share"),
    [(3e-6, 9e-6, [0, 1]), (9e-6, 3e-6, [1, 0]), (3e-6, 3e-6, [0, 0]), (9e-6, -9e-6, [1, 1])],
)
def test_planes_rest_one_by_one(x, y, share):
    wanted = replace(Adjustments.none(np.zeros(4), 2), dead_band=(5e-6, 5e-6))
    acts = restrain(Gathered(), two_planes(x, y), wanted, NAMES)
    np.testing.assert_array_equal(acts.share, share)
    np.testing.assert_array_equal(acts.checked.error != 0, np.repeat(np.array(share) > 0, 2))


def test_a_plane_of_which_nothing_is_seen_rests():
    wanted = replace(Adjustments.none(np.zeros(4), 2), dead_band=(5e-6, 5e-6))
    valid = np.array([False, False, True, True])
    np.testing.assert_array_equal(
        restrain(Gathered(), two_planes(9e-6, 9e-6, valid), wanted, NAMES).share, [0, 1]
    )


def test_a_bpm_counts_with_the_orbits_in_which_it_was_valid():
    wanted = replace(Adjustments.none(np.zeros(4), 2), average=3)
    valid, gathered = np.array([False, True, True, True]), Gathered()
    for x, mask in ((1e-6, valid), (2e-6, np.ones(4, dtype=bool))):
        acts = restrain(gathered, two_planes(x, 0.0, mask), wanted, NAMES)
        assert not acts.due and not acts.share.any()
        gathered = acts.gathered
    acts = restrain(gathered, two_planes(6e-6, 0.0), wanted, NAMES)
    assert acts.due and acts.share.all() and acts.gathered == Gathered()
    np.testing.assert_allclose(acts.checked.error[:2], [4e-6, 3e-6])


def test_what_makes_no_sense_is_refused():
    bench = Bench()
    for changes in ({"average": 0}, {"dead_band": (-1e-6,)}, {"dead_band": (1e-6, 1e-6)}):
        with pytest.raises(ControlError, match="nothing was changed"):
            adjust(bench, **changes)
    with pytest.raises(ControlError, match="nothing was changed"):
        adjust(bench, dead_band=(float("nan"),))
    assert bench.runner.adjustments.average == 1 and len(bench.machine.writes) == 0
    assert len(bench.runner.adjustments.gain) == M

"""What operators change while the loop runs: in force between two ticks, without a bump."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scripted import PERIOD, RESPONSE, ConstantPolicy, InversePolicy, M, N
from test_runner import PATIENT, Bench

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.adjustments import Adjustments, approach
from orbitfb.loop.excitation.dither import Dither, DitherSettings
from orbitfb.loop.slot import PolicySlot

REFERENCE = np.linspace(-50e-6, 50e-6, N)


def adjust(bench: Bench, **changes: object) -> None:
    before = bench.runner.adjustments
    now = {"gain": before.gain, "reference": before.reference, "enabled": before.enabled}
    bench.runner.adjust(Adjustments(**(now | changes)))


def test_the_gain_scales_the_next_change_and_moves_nothing_by_itself():
    bench = Bench(ConstantPolicy(np.full(M, 1e-3)), interlocks=PATIENT).close()
    whole = bench.step().applied
    adjust(bench, gain=np.array([1.0, 0.5, 0.25, 0.0]))
    part = bench.step().applied
    np.testing.assert_allclose(part, whole * [1.0, 0.5, 0.25, 0.0])
    assert bench.runner.state is LoopState.CLOSED


def test_the_reference_moves_at_its_speed_while_closed():
    bench = Bench(reference_speed=100e-6).close()
    adjust(bench, reference=REFERENCE)
    seen = [bench.step().reference for _ in range(7)]
    steps = np.abs(np.diff([np.zeros(N), *seen], axis=0)).max(axis=1)
    np.testing.assert_allclose(steps[:5], 100e-6 * PERIOD, rtol=1e-9)
    np.testing.assert_allclose(steps[5:], 0.0, atol=1e-15)
    np.testing.assert_array_equal(seen[-1], REFERENCE)
    for reference in seen:  # on the straight way
        part = np.abs(reference).max() / np.abs(REFERENCE).max()
        np.testing.assert_allclose(reference, part * REFERENCE)


def test_the_orbit_follows_the_reference_without_a_trip():
    """Also one that the correctors cannot make: the error grows at every tick of the way."""
    bench = Bench(reference_speed=100e-6).close()
    for _ in range(20):
        bench.step()
    unreachable = np.linalg.svd(RESPONSE)[0][:, -1] * 200e-6
    adjust(bench, reference=unreachable)
    for _ in range(40):
        bench.step()
    assert bench.runner.state is LoopState.CLOSED
    reachable = RESPONSE @ np.ones(M)
    adjust(bench, reference=reachable)
    for _ in range(40):
        last = bench.step()
    assert bench.runner.state is LoopState.CLOSED
    np.testing.assert_allclose(last.reading.orbit.position, reachable, atol=2e-6)


@pytest.mark.parametrize("start", [LoopState.OPEN, LoopState.SHADOW])
def test_a_loop_that_does_not_write_takes_the_reference_at_once(start: LoopState):
    bench = Bench(start=start)
    adjust(bench, reference=REFERENCE)
    np.testing.assert_array_equal(bench.step().reference, REFERENCE)


def test_a_held_loop_keeps_its_reference_until_it_writes_again():
    bench = Bench(proving=2).close()
    bench.step("missing", "missing")
    assert bench.runner.state is LoopState.HELD
    adjust(bench, reference=REFERENCE)
    assert not bench.step().reference.any()


def test_a_disabled_bpm_does_not_count_and_is_no_loss():
    """It is as one that is masked by configuration: the quota is of the others."""
    bench = Bench().close()
    enabled = np.ones(N, dtype=bool)
    enabled[:3] = False  # one more than max_invalid_bpms
    adjust(bench, enabled=enabled)
    record = bench.step()
    np.testing.assert_array_equal(record.reading.orbit.valid, enabled)
    assert (record.state, record.reason) == (LoopState.CLOSED, "")
    adjust(bench, enabled=np.ones(N, dtype=bool))
    assert bench.step().reading.orbit.valid.all()


@pytest.mark.parametrize(
    "changes",
    [
        {"gain": np.ones(M + 1)},
        {"gain": np.full(M, np.nan)},
        {"gain": np.full(M, -0.1)},
        {"reference": np.zeros(N - 1)},
        {"reference": np.full(N, np.inf)},
        {"enabled": np.ones(N + 1, dtype=bool)},
    ],
)
def test_what_does_not_fit_changes_nothing(changes: dict[str, object]):
    bench = Bench().close()
    before = bench.runner.adjustments
    with pytest.raises(ControlError):
        adjust(bench, **changes)
    assert bench.runner.adjustments is before


@given(
    st.lists(st.floats(-1e-3, 1e-3), min_size=4, max_size=4),
    st.lists(st.floats(-1e-3, 1e-3), min_size=4, max_size=4),
    st.floats(1e-6, 1e-3),
)
def test_the_way_to_a_reference_ends_there_in_limited_steps(now, aim, step):
    at, end = np.array(now), np.array(aim)
    ticks = int(np.ceil(np.abs(end - at).max() / step)) + 2
    for _ in range(ticks):
        after = approach(at, end, step)
        assert np.abs(after - at).max() <= step * (1 + 1e-9)
        at = after
    np.testing.assert_array_equal(at, end)


class Halved:
    """Another law than the one inside."""

    def __init__(self, inside):
        self.policy_id, self.inside = inside.policy_id, inside

    def initial_state(self):
        return self.inside.initial_state()

    def act(self, error, valid, state):
        change, after = self.inside.act(error, valid, state)
        return change / 2, after


def test_a_dressed_policy_acts_and_the_slot_still_tells_the_one_inside():
    first, second = InversePolicy("a"), InversePolicy("b")
    slot = PolicySlot(first)
    assert slot.acting is slot.current is first
    slot.redress(Halved)
    assert slot.current is first and slot.acting.inside is first and slot.swaps == 0
    assert slot.swap(second) is first
    assert slot.current is second and slot.acting.inside is second and slot.swaps == 1
    slot.redress(lambda policy: policy)
    assert slot.acting is second


def test_the_loop_decides_with_the_dressed_policy():
    bench = Bench(ConstantPolicy(np.full(M, 1e-3)), interlocks=PATIENT).close()
    whole = bench.step().applied
    bench.slot.redress(Halved)
    np.testing.assert_allclose(bench.step().applied, whole / 2)


def test_a_dither_is_retuned_and_takes_its_last_excursion_back():
    dither = Dither(DitherSettings(orbit_cost=1e-6), RESPONSE)
    first = dither.amplitude
    dither.settle(dither.propose())
    dither.retune(2e-6)
    assert dither.amplitude == pytest.approx(2 * first) and dither.orbit_cost == 2e-6
    dither.settle(dither.propose())
    dither.retune(movable=np.array([False, True, True, True]))
    dither.settle(dither.propose())
    assert dither.excursion[0] == 0.0 and (dither.excursion[1:] != 0).all()
    dither.retune(0.0)
    dither.settle(dither.propose())
    assert not dither.excursion.any() and not dither.propose().any()

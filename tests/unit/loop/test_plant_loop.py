"""The loop on the simulated ring in process, as `evaluate` runs it."""

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import LoopState
from orbitfb.loop.machines.masked import MaskedMachine
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.answers.questions import Ring as AnsweringRing
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings


@pytest.fixture(scope="module")
def ring():
    return Ring.load()


def build(ring, seed=0, counting=None, slot=None, **keywords):
    clock, records = ManualClock(), []
    machine = PlantMachine(Plant(ring, "x", seed=seed), clock)
    policy = SvdPolicy(machine.plant.nominal_response, SvdSettings())
    runner = Runner(
        machine if counting is None else MaskedMachine(machine, counting),
        slot or PolicySlot(policy),
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(**keywords),
        np.zeros(180),
        clock,
        start=LoopState.CLOSED,
        subscribers=(records.append,),
        counting=counting,
        random=np.random.default_rng(seed),
    )
    return machine, runner, records


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_closing_takes_the_orbit_from_250_um_to_below_1_um_within_5_s(ring, seed):
    _, runner, records = build(ring, seed)
    rms = {}
    while len(records) < 200:
        record = runner.step()
        rms[record.tick] = np.sqrt(np.mean(record.reading.orbit.position**2))
    closed = next(record.tick for record in records if record.state is LoopState.CLOSED)
    assert rms[0] > 200e-6
    later = [rms[tick] for tick in range(closed + 50, 200)]
    assert np.quantile(later, 0.95) < 1e-6
    assert max(later) < 2e-6  # a tick that asks whether the orbit answers may be above
    assert all(record.state is LoopState.CLOSED for record in records[closed:])
    assert max(np.abs(record.setpoints).max() for record in records) <= 17.5
    assert sum(record.missed for record in records) == 0


def test_who_swaps_the_policy_looks_at_its_ring_and_the_tick_does_not_wait(ring, monkeypatch):
    policy = SvdPolicy(Plant(ring, "x", seed=0).nominal_response, SvdSettings())
    slot = PolicySlot(policy)
    _, runner, _ = build(ring, slot=slot)
    for _ in range(10):
        runner.step()
    slot.swap(SvdPolicy(1.01 * policy.response, policy.settings))
    monkeypatch.setattr(AnsweringRing, "of", None)
    assert runner.step().state is LoopState.CLOSED
    slot.swap(policy)
    assert runner.step().state is LoopState.CLOSED


def test_a_flapping_machine_is_never_written_blind(ring):
    machine, runner, _ = build(ring)
    for round_trip in range(6):
        for _ in range(10):
            runner.step()
        (machine.freeze if round_trip % 2 else lambda: machine.fail_next_reads(2))()
        for _ in range(3):
            record = runner.step()
            assert np.isnan(record.written)
        assert runner.state is LoopState.HELD
        machine.thaw()
    for _ in range(40):
        record = runner.step()
    assert record.state is LoopState.CLOSED
    assert np.sqrt(np.mean(record.reading.orbit.position**2)) < 1e-6


def test_masked_bpms_are_left_to_the_policy_up_to_the_quota(ring):
    machine, runner, _ = build(ring, max_invalid_bpms=2)
    machine.mask(3, 77)
    for _ in range(60):
        record = runner.step()
    assert record.state is LoopState.CLOSED
    assert machine.true_orbit_rms < 2e-6
    machine.mask(90)
    assert runner.step().state is LoopState.HELD


def test_bpms_masked_by_configuration_leave_the_quota_whole(ring):
    counting = np.arange(180) >= 12
    machine, runner, _ = build(ring, counting=counting, max_invalid_bpms=2)
    machine.mask(3, 77, 90)  # the first is masked anyway
    for _ in range(60):
        record = runner.step()
    assert record.state is LoopState.CLOSED
    assert record.reason == "2 of 168 BPMs are invalid: " + ", ".join(
        machine.channels.bpms[index] for index in (77, 90)
    )
    machine.mask(100)
    assert runner.step().state is LoopState.HELD

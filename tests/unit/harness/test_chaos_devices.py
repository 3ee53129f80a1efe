"""Devices of the chaos campaign that look alive and do not answer."""

from types import SimpleNamespace

import numpy as np
import pytest

from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.sim.job import SimJob
from tests.chaos.devices import FaultyRing
from tests.chaos.ioc import Desk
from tests.chaos.kinds import KINDS


@pytest.fixture(scope="module")
def ring():
    return Ring.load()


def faulty(ring, name):
    quiet = PlantSettings(ground_motion_rms=0.0, initial_orbit_rms=0.0)
    wrapped = FaultyRing(Plant(ring, "x", quiet, seed=1))
    kind = next(kind for kind in KINDS if kind.name == name)
    return wrapped, kind.draw(np.random.default_rng(3)) | {"id": "1"}


@pytest.mark.parametrize("name", ["BPMs all blind", "BPMs of a cell blind", "BPM blind"])
def test_blind_bpms_do_not_follow_and_look_alive(ring, name):
    wrapped, fault = faulty(ring, name)
    wrapped.faults = [fault]
    before = wrapped.step(np.zeros(180)).reading.copy()
    shown = [wrapped.step(np.full(180, 0.5)).reading.copy() for _ in range(2)]
    blind = np.zeros(180, bool)
    blind[fault["blind"]] = True
    assert np.abs(shown[0] - before)[blind].max() < 2e-6
    assert (shown[0] != shown[1]).all()
    if not blind.all():
        assert np.abs(shown[0] - before)[~blind].max() > 100e-6


def test_a_blind_bpm_that_reads_nan_shows_it(ring):
    """It had shown a number, and a write that followed counted as one on an orbit not to act on."""
    wrapped, fault = faulty(ring, "BPMs all blind")
    wrapped.faults = [fault, {"id": "2", "bpms": {"3": "nan"}}]
    assert np.flatnonzero(np.isnan(wrapped.step(np.zeros(180)).reading)).tolist() == [3]


@pytest.mark.parametrize("name", ["supplies all deaf", "supplies of a cell deaf", "supply deaf"])
def test_deaf_supplies_echo_their_setpoint_and_jump_when_they_are_back(ring, name):
    wrapped, fault = faulty(ring, name)
    wrapped.faults = [fault]
    wrapped.step(np.zeros(180))
    setpoints = np.zeros(180)
    setpoints[fault["deaf"]] = 0.5
    shown = wrapped.step(setpoints)
    np.testing.assert_array_equal(shown.readback, setpoints)
    assert np.abs(shown.true_orbit).max() < 1e-9
    wrapped.faults = []
    assert np.abs(wrapped.step(setpoints).true_orbit).max() > 10e-6


def test_a_bpm_that_stamps_itself_may_not_be_acted_on_with_many_others(ring):
    wrapped, fault = faulty(ring, "BPM stamped 1.5 ms ahead")
    wrapped.faults = [fault]
    wrapped.step(np.zeros(180))
    assert {int(index): told for index, told in fault["bpms"].items()} == wrapped.board_faults
    wrapped.faults = [{"id": "1", "bpms": dict.fromkeys(map(str, range(0, 60, 3)), "apart")}]
    wrapped.step(np.zeros(180))
    assert not wrapped.good


def test_what_is_slow_and_who_refuses_is_known_while_it_lasts(ring):
    wrapped, slow = faulty(ring, "orbits at a third of the rate")
    _, refusing = faulty(ring, "corrector refuses puts")
    wrapped.faults = [slow, refusing]
    assert wrapped.slowness() == 3
    assert wrapped.refusing() == refusing["refuse"]
    wrapped.faults = []
    assert (wrapped.slowness(), wrapped.refusing()) == (1, [])


@pytest.fixture
def desk():
    simulated, _ = SimJob(seed=1).build()
    return Desk(FaultyRing(simulated), SimpleNamespace(tick=lambda *_: None), drive=1.2)


def test_time_goes_by_at_a_tick_that_nobody_is_told_of(desk):
    """A server has the setpoint of the RF behind those of the correctors."""
    server = SimpleNamespace(front=SimpleNamespace(setpoints=np.append(np.zeros(180), 5e8)))
    before = int(desk.faulty.tick)
    desk.let_pass(server)
    assert int(desk.faulty.tick) == before + 1
    desk.after_tick(server, shown=False)
    assert len(desk._kept) == 180


def test_what_is_asked_of_a_channel_that_is_gone_is_lost_and_the_server_goes_on(desk):
    name = desk.faulty.channels.orbit_pvs[7]
    channels = {3: SimpleNamespace(name=name), 4: SimpleNamespace(name="another")}
    circuit = SimpleNamespace(circuit=SimpleNamespace(channels_sid=channels))
    read = SimpleNamespace(sid=3)
    assert not desk.is_lost(circuit, read)
    desk._away = {7}
    assert desk.is_lost(circuit, read)
    assert not desk.is_lost(circuit, SimpleNamespace(sid=4))
    assert not desk.is_lost(circuit, SimpleNamespace())

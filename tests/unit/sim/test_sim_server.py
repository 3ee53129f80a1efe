"""The ring behind both fronts, without a network."""

import asyncio
from dataclasses import dataclass, replace

import numpy as np
import pytest
from caproto import ChannelType
from test_sim_board import CHANNELS

from orbitfb.sim.environment import client_environment, server_environment
from orbitfb.sim.job import SimJob
from orbitfb.sim.server import RingServer, send_buffer
from orbitfb.sim.settings import SimSettings


@dataclass
class State:
    reading: np.ndarray
    true_orbit: np.ndarray
    readback: np.ndarray


class Ring:
    """A stand-in: the orbit is the sum of the setpoints, in mm."""

    channels = CHANNELS

    def __init__(self):
        self.tick = 0
        self.kicks = []

    def step(self, setpoints, frequency_change=0.0):
        self.tick += 1
        self.frequency_change = frequency_change
        orbit = np.full(3, setpoints.sum() * 1e-3)
        return State(orbit, orbit, setpoints.copy())

    def kick(self, rms):
        self.kicks.append(rms)


@pytest.fixture(params=["fast", "plain"])
def settings(request):
    return SimSettings(plain=request.param == "plain", lockstep=True, rate_hz=0.001)


def channels(server):
    """The PVs by name, without sockets."""
    front = server.front
    if hasattr(front, "board"):
        found = dict(zip(front.board.names, front._channels, strict=True))
    else:
        specs = (*server.layout.readings, *server.layout.setpoints)
        names = [spec.name for spec in specs]
        found = dict(zip(names, [*front._readings, *front._setpoints], strict=True))
    return found | front._knobs


async def value(channel):
    return (await channel.read(ChannelType.DOUBLE))[1][0]


def test_a_setpoint_that_is_left_alone_is_waited_for_once(settings):
    async def scenario():
        ring = Ring()
        server = RingServer(ring, settings)
        server.start()
        pvs = channels(server)
        try:
            await asyncio.sleep(0.01)
            await pvs["c{2}:SP"].write(4.0)
            assert ring.tick == 1
            server.tick()  # as after the period
            await asyncio.sleep(0.01)
            await pvs["c{2}:SP"].write(5.0)
            assert ring.tick == 3
            await asyncio.sleep(0.01)
            server.tick()
            await asyncio.sleep(0.01)  # nothing was written: as before
            await pvs["c{1}:SP"].write(1.0)
            assert ring.tick == 4
            await pvs["c{2}:SP"].write(5.0)
            assert ring.tick == 5
            await asyncio.sleep(0.01)
            await pvs["c{2}:SP"].write(5.0)
            assert ring.tick == 5  # both are awaited again
        finally:
            server.stop()

    asyncio.run(scenario())


def test_the_ring_ticks_when_every_setpoint_was_written(settings):
    async def scenario():
        ring = Ring()
        server = RingServer(ring, settings)
        server.start()
        pvs = channels(server)
        try:
            assert ring.tick == 1
            await asyncio.sleep(0)
            await pvs["c{1}:SP"].write(2.0)
            await pvs["c{1}:SP"].write(3.0)
            assert ring.tick == 1
            await pvs["c{2}:SP"].write(4.0)
            assert ring.tick == 2
            await asyncio.sleep(0)
            assert await value(pvs["b{2}"]) == 7.0
            assert await value(pvs["c{1}:RB"]) == 3.0
            await pvs["c{2}:SP"].write(4.0)
            assert ring.tick == 2
        finally:
            server.stop()

    asyncio.run(scenario())


def test_what_is_refused_neither_changes_nor_counts(settings):
    async def scenario():
        ring = Ring()
        server = RingServer(ring, settings)
        server.start()
        pvs = channels(server)
        try:
            await asyncio.sleep(0)
            await pvs["c{1}:SP"].write(2.0)
            for bad in (18.5, float("nan"), float("-inf")):
                with pytest.raises(ValueError, match="Cannot write"):
                    await pvs["c{2}:SP"].write(bad)
            assert ring.tick == 1
            assert server.front.setpoints.tolist() == [2.0, 0.0, 0.0]
            assert pvs["c{2}:SP"].alarm.severity == 2
            assert pvs["c{1}:SP"].alarm.severity == 0
            with pytest.raises(ValueError, match="Cannot write"):
                await pvs["SR:SIM{Ring}Kick-SP"].write(-0.1)
            assert ring.kicks == []
            await pvs["SR:SIM{Ring}Kick-SP"].write(0.25)
            assert ring.kicks == [0.25e-3]
            with pytest.raises(ValueError, match="Cannot write"):
                await pvs["SR:SIM{Ring}Current-SP"].write(500.1)
            await pvs["SR:SIM{Ring}Current-SP"].write(4.0)
            server.tick()
            await asyncio.sleep(0)
            assert await value(pvs["SR:C03-BI{DCCT:1}I:Real-I"]) == 4.0
        finally:
            server.stop()

    asyncio.run(scenario())


def test_a_ring_that_fails_stands_still_and_says_so(settings):
    async def scenario():
        ring = Ring()
        server = RingServer(ring, settings)
        server.start()
        await asyncio.sleep(0)
        ring.step = None
        server.tick()
        server.tick()
        server.stop()
        assert server.failed.done()
        assert isinstance(server.failed.exception(), TypeError)

    asyncio.run(scenario())


def test_a_tick_fits_into_the_send_buffer_but_caproto_has_its_own():
    """Of a tick that does not fit the rest waits for the client's delayed acknowledgement."""

    class Large(Ring):
        channels = replace(CHANNELS, orbit_pvs=tuple(f"P{i}" for i in range(2000)))

    readings = 2000 + 2 + 4  # BPMs, readbacks, slow ones
    assert send_buffer(Large(), SimSettings()) == readings * 40 > 32768
    assert send_buffer(Ring(), SimSettings()) == 32768
    assert send_buffer(Large(), SimSettings(plain=True)) is None


def test_environments_keep_to_loopback_and_off_production():
    client = client_environment(15064)
    assert client["EPICS_CA_ADDR_LIST"] == "127.0.0.1"
    assert client["EPICS_CA_AUTO_ADDR_LIST"] == "NO"
    assert client["EPICS_CA_SERVER_PORT"] == "15064"
    assert client["EPICS_CA_REPEATER_PORT"] not in ("5065", "15064")
    assert 0 < int(client_environment(65535)["EPICS_CA_REPEATER_PORT"]) < 65536
    assert server_environment(plain=False)["EPICS_CAS_BEACON_ADDR_LIST"] == "127.0.0.1"


def test_a_job_survives_its_line_of_json():
    job = SimJob.model_validate({"planes": "xy", "seed": 3, "sim": {"port": 0, "lockstep": True}})
    assert SimJob.model_validate_json(job.model_dump_json()) == job
    assert "\n" not in job.model_dump_json()


def test_a_write_that_brings_limits_along_is_refused(settings):
    """Else zeros as limits would mean none, and the next write could be anything."""

    async def scenario():
        server = RingServer(Ring(), settings)
        pvs = channels(server)
        for name in ("c{1}:SP", "SR:SIM{Ring}Current-SP"):
            for data_type in (ChannelType.CTRL_DOUBLE, ChannelType.STS_DOUBLE):
                with pytest.raises(ValueError, match="plain values only"):
                    await pvs[name].auth_write("here", "me", [0.0], data_type, b"\0" * 80)
            with pytest.raises(ValueError, match="Cannot write"):
                await pvs[name].auth_write("here", "me", [1e6], ChannelType.DOUBLE, None)

    asyncio.run(scenario())


def test_the_rf_setpoint_moves_the_ring_within_its_limits(settings):
    async def scenario():
        ring = Ring()
        server = RingServer(ring, settings.model_copy(update={"rf_frequency": 5e8}))
        server.start()
        rf = channels(server)["RF{Osc:1}Freq:SP"]
        try:
            await asyncio.sleep(0)
            await rf.write(5e8 + 2.5)
            assert ring.tick == 1  # no corrector: nobody waits for it
            for bad in (5e8 + 1000.1, float("nan")):
                with pytest.raises(ValueError, match="Cannot write"):
                    await rf.write(bad)
            server.tick()
            await asyncio.sleep(0.01)
            assert ring.frequency_change == 2.5
            assert await value(channels(server)["RF{Osc:1}Freq:I"]) == 5e8 + 2.5
        finally:
            server.stop()

    asyncio.run(scenario())

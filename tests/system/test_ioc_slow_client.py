"""A client that does not read, and what the others see of it."""

import threading
import time

import pytest
from ioc_clients import CHANNELS, CONTROL_DOUBLE, KICK, READINGS, TICK, RawClient, same, serving

pytestmark = pytest.mark.system

RATE = 200.0
EPICS_EPOCH = 631152000


def age(event):
    return time.time() - (event.stamp[0] + EPICS_EPOCH + event.stamp[1] * 1e-9)


def subscribed(port, **options):
    client = RawClient(port, **options)
    client.create(*READINGS, *CHANNELS.setpoint_pvs, KICK)
    client.subscribe(*READINGS)
    return client


def watch(client, seconds):
    """Read frames for a while: their ticks, ages and wholeness."""
    client.events(len(READINGS))
    client.frame()
    ticks, ages, end = [], [], time.monotonic() + seconds
    while time.monotonic() < end:
        frame = client.frame()
        assert [event.name for event in frame] == list(READINGS) and same(frame)
        ticks.append(frame[-1].value)
        ages.append(age(frame[-1]))
    return ticks, ages


def test_clients_that_never_read_do_not_slow_the_ring():
    with serving(rate_hz=RATE) as child, subscribed(child.port) as good:
        stuck = [subscribed(child.port, receive_buffer=4096) for _ in range(3)]
        for client in stuck:
            client.subscribe(*CHANNELS.setpoint_pvs)
        ticks, ages = watch(good, 4.0)
        good.put(dict.fromkeys(CHANNELS.setpoint_pvs, 1.0))
        for client in stuck:
            client.socket.close()
    rate = (ticks[-1] - ticks[0]) / 4.0
    assert rate == pytest.approx(RATE, rel=0.05)
    assert len(ticks) > 0.9 * 4.0 * RATE
    ages.sort()
    assert ages[len(ages) // 2] < 0.05


def test_nor_do_they_where_caproto_itself_serves():
    """Types that the fast front leaves to caproto go through a queue of caproto's."""
    with serving(rate_hz=RATE) as child, RawClient(child.port) as good:
        good.create(TICK)
        stuck = subscribed(child.port, receive_buffer=4096)
        stuck.subscribe(*READINGS[:15], data_type=CONTROL_DOUBLE)
        time.sleep(3.0)
        good.subscribe(TICK, data_type=CONTROL_DOUBLE)
        first = good.event().value
        assert first > 2.0 * RATE
        later = [good.event().value for _ in range(20)]
        assert later == sorted(later) and later[-1] >= first + 19
        stuck.socket.close()


def test_a_slow_client_sees_whole_orbits_that_are_not_old():
    with (
        serving(rate_hz=RATE, send_buffer=8192) as child,
        subscribed(child.port, receive_buffer=8192) as slow,
    ):
        slow.events(len(READINGS))
        slow.frame()
        frames = []
        for _ in range(40):
            time.sleep(0.05)
            frames.append((slow.frame(), time.monotonic()))
            assert age(frames[-1][0][-1]) < 1.0
    for frame, _ in frames:
        assert [event.name for event in frame] == list(READINGS) and same(frame)
    ticks = [frame[-1].value for frame, _ in frames]
    assert ticks == sorted(ticks)
    assert ticks[-1] - ticks[0] > 4 * len(ticks)  # whole orbits were left out


def test_a_client_that_wakes_up_gets_the_newest_orbit_soon():
    with serving(rate_hz=RATE) as child, subscribed(child.port, receive_buffer=8192) as client:
        time.sleep(2.0)
        awake = time.monotonic()
        while age(client.frame()[-1]) > 0.1:
            assert time.monotonic() - awake < 1.0
        assert client.get(TICK).value > 300


def test_two_writers_and_a_reader_at_once():
    with serving(rate_hz=100) as child, subscribed(child.port) as good:
        stop = threading.Event()

        def write():
            with RawClient(child.port) as writer:
                writer.create(*CHANNELS.setpoint_pvs)
                while not stop.wait(0.002):
                    writer.put(dict.fromkeys(CHANNELS.setpoint_pvs, 0.1))

        writers = [threading.Thread(target=write) for _ in range(2)]
        for writer in writers:
            writer.start()
        try:
            ticks, _ = watch(good, 2.0)
        finally:
            stop.set()
            for writer in writers:
                writer.join()
    assert (ticks[-1] - ticks[0]) / 2.0 == pytest.approx(100, rel=0.05)

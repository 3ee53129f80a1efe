"""A client that does not read, and what the others see of it."""

import contextlib
import statistics
import threading
import time

import pytest
from ioc_clients import CHANNELS, CONTROL_DOUBLE, KICK, READINGS, TICK, RawClient, quick_ring, same
from service_process import wait_for

pytestmark = [pytest.mark.system, pytest.mark.timing]

RATE = 200.0
EPICS_EPOCH = 631152000


def age(event):
    return time.time() - (event.stamp[0] + EPICS_EPOCH + event.stamp[1] * 1e-9)


def subscribed(port, **options):
    client = RawClient(port, **options)
    client.create(*READINGS, *CHANNELS.setpoint_pvs, KICK)
    client.subscribe(*READINGS)
    return client


def go_past(port, tick):
    """Wait until the ring has come to a tick."""
    with RawClient(port) as client:
        client.create(TICK)
        wait_for(f"tick {tick}", lambda: client.get(TICK).value > tick)


def watch(client, rate, count=25):
    """Read frames until so many in a row were whole, fresh and at the full rate.

    A computer that is busy with other things has its free moments; a ring
    that is held back has none.
    """
    client.events(len(READINGS))
    client.frame()
    wait_for(f"{count} fresh ticks at {rate} Hz", lambda: _at_full_rate(client, rate, count), 2.0)


def _at_full_rate(client, rate, count):
    ticks, ages, times = [], [], []
    for _ in range(count):
        frame = client.frame()
        times.append(time.monotonic())
        assert [event.name for event in frame] == list(READINGS) and same(frame)
        ticks.append(frame[-1].value)
        ages.append(age(frame[-1]))
    seen = (ticks[-1] - ticks[0]) / (times[-1] - times[0])
    whole = count > 0.9 * (ticks[-1] - ticks[0])
    return whole and abs(seen / rate - 1.0) < 0.05 and statistics.median(ages) < 0.05


def test_clients_that_never_read_do_not_slow_the_ring():
    with (
        quick_ring(rate_hz=50.0) as child,
        subscribed(child.port) as good,
        contextlib.ExitStack() as stack,
    ):
        for _ in range(3):
            client = stack.enter_context(subscribed(child.port, receive_buffer=4096))
            client.subscribe(*CHANNELS.setpoint_pvs)
        go_past(child.port, 100)  # whatever is kept for them is full
        watch(good, 50.0)
        good.put(dict.fromkeys(CHANNELS.setpoint_pvs, 1.0))


@pytest.mark.nightly
def test_nor_do_they_where_caproto_itself_serves():
    """Types that the fast front leaves to caproto go through a queue of caproto's."""
    with (
        quick_ring(rate_hz=RATE) as child,
        RawClient(child.port) as good,
        subscribed(child.port, receive_buffer=4096) as stuck,
    ):
        good.create(TICK)
        stuck.subscribe(*READINGS[:15], data_type=CONTROL_DOUBLE)
        go_past(child.port, 3 * RATE)
        good.subscribe(TICK, data_type=CONTROL_DOUBLE)
        first = good.event().value
        assert first > 2.0 * RATE
        later = [good.event().value for _ in range(20)]
        assert later == sorted(later) and later[-1] >= first + 19


@pytest.mark.nightly
def test_a_slow_client_sees_whole_orbits_that_are_not_old():
    with (
        quick_ring(rate_hz=RATE, send_buffer=8192) as child,
        subscribed(child.port, receive_buffer=8192) as slow,
    ):
        slow.events(len(READINGS))
        slow.frame()
        frames, ages = [], []
        for _ in range(40):
            time.sleep(0.05)
            frames.append(slow.frame())
            ages.append(age(frames[-1][-1]))
    assert statistics.median(ages[-10:]) < 1.0  # they would be by now, were all of them kept
    for frame in frames:
        assert [event.name for event in frame] == list(READINGS) and same(frame)
    ticks = [frame[-1].value for frame in frames]
    assert ticks == sorted(ticks)
    assert ticks[-1] - ticks[0] > 4 * len(ticks)  # whole orbits were left out


def test_a_client_that_wakes_up_gets_the_newest_orbit_soon():
    with quick_ring(rate_hz=RATE) as child, subscribed(child.port, receive_buffer=8192) as client:
        go_past(child.port, 400)
        ticks = [client.frame()[-1].value]
        while ticks[-1] < 400:
            ticks.append(client.frame()[-1].value)
        assert len(ticks) < 50  # not all that it has slept through


@pytest.mark.nightly
def test_two_writers_and_a_reader_at_once():
    with quick_ring(rate_hz=20) as child, subscribed(child.port) as good:
        stop = threading.Event()

        def write():
            with RawClient(child.port) as writer:
                writer.create(*CHANNELS.setpoint_pvs)
                while not stop.wait(0.01):
                    writer.put(dict.fromkeys(CHANNELS.setpoint_pvs, 0.1))

        writers = [threading.Thread(target=write) for _ in range(2)]
        for writer in writers:
            writer.start()
        try:
            watch(good, 20.0)
        finally:
            stop.set()
            for writer in writers:
                writer.join()

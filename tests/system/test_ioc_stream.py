"""What goes over the wire: frames, stamps, order, cancellation, setpoints."""

import itertools
import math
import statistics
import struct
import time

import pytest
from ioc_clients import (
    CHANNELS,
    CONTROL_DOUBLE,
    DOUBLE,
    KICK,
    READINGS,
    RMS,
    TICK,
    TIME_DOUBLE,
    RawClient,
    quick_ring,
    same,
)

pytestmark = pytest.mark.system

SETPOINTS = CHANNELS.setpoint_pvs
MAJOR, WRITE_ALARM, PUT_FAILED = 2, 2, 160


@pytest.fixture
def stepped():
    """A ring that ticks when all setpoints have been written, and else every 50 s."""
    with quick_ring(lockstep=True, rate_hz=0.02) as child, RawClient(child.port) as client:
        client.create(*READINGS, *SETPOINTS, KICK)
        yield client


@pytest.fixture(scope="module")
def standing():
    """A ring for all tests that look at single setpoints only: it hardly ever ticks."""
    with quick_ring(lockstep=True, rate_hz=0.02) as child:
        yield child


@pytest.fixture
def single(standing):
    """A client of its own of the ring that is shared."""
    with RawClient(standing.port) as client:
        client.create(*SETPOINTS[3:5])
        yield client


@pytest.mark.timing
def test_a_tick_is_one_frame_in_table_order_under_one_stamp():
    with quick_ring(rate_hz=50) as child, RawClient(child.port) as client:
        client.create(*READINGS)
        client.subscribe(*reversed(READINGS))
        while [event.name for event in client.frame()] != list(READINGS):
            pass  # ticks come in between subscriptions and the first values of each
        for _ in range(30):  # until this computer leaves it alone for so long
            frames = [client.frame() for _ in range(20)]
            for frame in frames:
                assert [event.name for event in frame] == list(READINGS)
                assert same(frame)
            ticks = [frame[-1].value for frame in frames]
            assert ticks == list(range(int(ticks[0]), int(ticks[0]) + 20))
            stamps = [frame[0].stamp for frame in frames]
            periods = [b[0] - a[0] + (b[1] - a[1]) * 1e-9 for a, b in itertools.pairwise(stamps)]
            if abs(statistics.median(periods) - 0.02) < 0.002:
                break
    assert statistics.median(periods) == pytest.approx(0.02, rel=0.1)
    assert abs(stamps[-1][0] + 631152000 + stamps[-1][1] * 1e-9 - time.time()) < 5


def test_setpoints_advance_the_ring_and_come_back_as_readbacks(stepped):
    stepped.subscribe(*READINGS)
    stepped.events(len(READINGS))
    for round_ in range(5):
        values = {name: 0.01 * row + round_ for row, name in enumerate(SETPOINTS)}
        stepped.put(values)
        frame = stepped.frame()
        assert len(frame) == len(READINGS) and same(frame)
        assert frame[-1].value == round_ + 2
        readbacks = [event.value for event in frame[:180]]
        assert readbacks == list(values.values())


@pytest.mark.timing
def test_an_orbit_does_not_wait_for_the_acknowledgement_of_setpoints(stepped):
    """Nagle's delay would hold it back for 40 ms."""
    stepped.subscribe(*READINGS, *SETPOINTS)
    stepped.events(len(READINGS) + len(SETPOINTS))
    for _ in range(30):  # until this computer leaves it alone for so long
        times = []
        for _ in range(20):
            begin = time.perf_counter()
            stepped.put(dict.fromkeys(SETPOINTS, 0.5))
            assert len(stepped.frame()) == len(READINGS) + len(SETPOINTS)
            times.append(time.perf_counter() - begin)
        if statistics.median(times) < 0.02:
            break
    assert statistics.median(times) < 0.02


def test_the_ring_stands_until_the_last_setpoint(stepped):
    stepped.put(dict.fromkeys(SETPOINTS[:-1], 1.0))
    assert stepped.get(TICK).value == 1
    stepped.put({SETPOINTS[-1]: 1.0})
    assert stepped.get(TICK).value == 2


def test_true_rms_is_that_of_the_orbit(stepped):
    orbit = [stepped.get(name).value for name in CHANNELS.orbit_pvs]
    rms = math.sqrt(sum(value**2 for value in orbit) / len(orbit))
    assert stepped.get(RMS).value == pytest.approx(rms, rel=1e-3)
    assert stepped.get(RMS).value == pytest.approx(0.25, rel=1e-3)


def test_a_kick_moves_the_orbit(stepped):
    before = stepped.get(RMS).value
    assert stepped.put_waiting(KICK, 1.0).command == 19
    stepped.put(dict.fromkeys(SETPOINTS, 0.0))
    assert abs(stepped.get(RMS).value - before) > 0.3
    assert stepped.put_waiting(KICK, math.nan).command == 11
    assert stepped.put_waiting(KICK, -1.0).command == 11
    assert stepped.get(KICK).value == 1.0


@pytest.mark.parametrize("waiting", [False, True])
@pytest.mark.parametrize("value", [18.01, -18.01, math.inf, -math.inf, math.nan, 1e300])
def test_a_setpoint_beyond_its_limits_is_refused_with_its_own_alarm(single, value, waiting):
    name, neighbour = SETPOINTS[3], SETPOINTS[4]
    single.put({name: 2.5})
    single.subscribe(name, neighbour)
    single.events(2)
    stamp = single.get(name).stamp
    if waiting:
        refusal = single.put_waiting(name, value)
    else:
        single.put({name: value})
        while (refusal := single.receive()).command != 11:
            pass
    assert refusal.second == PUT_FAILED
    seen = single.get(name)
    assert (seen.value, seen.stamp) == (2.5, stamp)
    assert (seen.status, seen.severity) == (WRITE_ALARM, MAJOR)
    assert single.get(neighbour).severity == 0
    single.put({name: 3.0})
    seen = single.get(name)
    assert (seen.value, seen.status, seen.severity) == (3.0, 0, 0)
    assert seen.stamp > stamp


def test_a_refusal_is_seen_by_monitors_with_the_old_value(stepped):
    stepped.subscribe(SETPOINTS[0])
    first = stepped.event()
    stepped.put({SETPOINTS[0]: math.nan})
    event = stepped.event()
    assert (event.value, event.severity, event.stamp) == (first.value, MAJOR, first.stamp)


def test_the_limit_itself_is_allowed_and_alarms(stepped):
    stepped.put({SETPOINTS[0]: 18.0, SETPOINTS[1]: -18.0, SETPOINTS[2]: 17.0})
    assert stepped.get(SETPOINTS[0]).status == 3  # HIHI
    assert stepped.get(SETPOINTS[1]).status == 5  # LOLO
    assert (stepped.get(SETPOINTS[2]).status, stepped.get(SETPOINTS[2]).severity) == (4, 1)


def test_setpoints_keep_their_order_across_both_ways(stepped):
    name = SETPOINTS[0]
    for round_ in range(20):
        stepped.put({name: 1.0})
        stepped.send((4, b"2.5\0\0\0\0\0", 0, 1, stepped.sid[name], 1))  # as a string
        stepped.put({name: 3.0 + 0.1 * round_})
        assert stepped.get(name).value == 3.0 + 0.1 * round_
        stepped.put({name: 3.0})
        stepped.send((4, b"2.5\0\0\0\0\0", 0, 1, stepped.sid[name], 1))
        assert stepped.get(name).value == 2.5


def test_readings_refuse_writes(stepped):
    for name in (READINGS[0], READINGS[200], TICK):
        assert stepped.rights[name] == 1
        before = stepped.get(name)
        assert stepped.put_waiting(name, 1.0).command == 11
        assert stepped.get(name) == before
    assert stepped.rights[SETPOINTS[0]] == 3


def test_setpoint_monitors_see_every_burst(stepped):
    stepped.subscribe(*SETPOINTS)
    stepped.events(len(SETPOINTS))
    stepped.put({SETPOINTS[5]: 1.0, SETPOINTS[2]: 2.0})
    events = stepped.events(2)
    assert [(e.name, e.value) for e in events] == [(SETPOINTS[2], 2.0), (SETPOINTS[5], 1.0)]


def test_late_subscribers_and_other_types_see_the_present(stepped):
    stepped.put(dict.fromkeys(SETPOINTS, 0.5))
    stepped.subscribe(TICK, READINGS[0])
    tick, orbit = stepped.events(2)
    assert tick.value == 2 and same([tick, orbit])
    stepped.subscribe(READINGS[0], data_type=DOUBLE)
    assert stepped.event().value == orbit.value
    assert stepped.get(READINGS[0]) == orbit
    stepped.subscribe(SETPOINTS[0], mask=4)  # alarms alone: caproto serves these
    assert stepped.event().value == 0.5


@pytest.mark.parametrize("data_type", [TIME_DOUBLE, CONTROL_DOUBLE])
def test_units_and_limits_that_never_change_are_told_once(stepped, data_type):
    stepped.subscribe(SETPOINTS[0], mask=8, data_type=data_type)
    assert stepped.event().name == SETPOINTS[0]
    stepped.put(dict.fromkeys(SETPOINTS, 0.5))
    stepped.subscribe(TICK)
    assert [event.name for event in stepped.events(1)] == [TICK]


def test_nothing_comes_after_a_cancellation_or_a_cleared_channel():
    with quick_ring(rate_hz=100) as child, RawClient(child.port) as client:
        client.create(*READINGS)
        client.subscribe(*READINGS)
        client.events(len(READINGS))
        client.frame()
        gone, cleared = READINGS[4], READINGS[6]
        client.cancel(gone)
        while (message := client.receive()).payload or message.command != 1:
            pass
        frames = [client.frame() for _ in range(5)]
        assert all(event.name != gone for frame in frames for event in frame)
        assert len(frames[-1]) == len(READINGS) - 1
        client.send((12, b"", 0, 0, client.sid[cleared], 6))
        while client.receive().command != 12:
            pass
        client.frame()
        frames = [client.frame() for _ in range(5)]
        assert [e.name for e in frames[-1]] == [n for n in READINGS if n not in (gone, cleared)]


def test_events_off_silences_and_events_on_brings_the_newest():
    with quick_ring(rate_hz=50) as child, RawClient(child.port) as client:
        client.create(*READINGS, *SETPOINTS)
        client.subscribe(*READINGS, SETPOINTS[0])
        client.events(len(READINGS) + 1)
        client.send((8, b"", 0, 0, 0, 0), (15, b"", 20, 1, client.sid[TICK], 1))
        while client.receive().command != 15:
            pass
        client.put({SETPOINTS[0]: 4.0})
        time.sleep(0.3)
        before = client.get(TICK).value
        client.send((9, b"", 0, 0, 0, 0))
        frame = client.frame()
        assert [event.name for event in frame] == list(READINGS)
        assert frame[-1].value >= before
        assert client.event().value == 4.0


def test_clients_that_leave_in_the_middle_disturb_nobody():
    with quick_ring(rate_hz=100) as child, RawClient(child.port) as watcher:
        watcher.create(*READINGS)
        watcher.subscribe(*READINGS)
        watcher.events(len(READINGS))
        watcher.frame()
        for _ in range(5):
            with RawClient(child.port) as leaver:
                leaver.create(*READINGS, *SETPOINTS)
                leaver.subscribe(*READINGS)
                leaver.put({SETPOINTS[0]: 1.0})
                leaver.socket.sendall(b"\0\4\0\10")  # half a put
        frames = [watcher.frame() for _ in range(20)]
        assert all(len(frame) == len(READINGS) and same(frame) for frame in frames)
        assert child.alive


def test_nonsense_ends_only_the_connection_that_sent_it():
    with quick_ring(rate_hz=50) as child, RawClient(child.port) as watcher:
        watcher.create(TICK)
        for nonsense in (b"\xff" * 64, b"\0\4\xff\xff" + b"\0" * 12 + b"\x7f" * 8, b"\0" * 8):
            with RawClient(child.port) as fool:
                fool.socket.sendall(nonsense)
        assert watcher.get(TICK).value > 0


def test_a_vector_that_comes_in_pieces_is_whole(stepped):
    values = {name: 0.1 * row for row, name in enumerate(SETPOINTS)}
    whole = b"".join(
        struct.pack(">HHHHIId", 4, 8, DOUBLE, 1, stepped.sid[name], 1, value)
        for name, value in values.items()
    )
    for start in range(0, len(whole), 100):
        stepped.socket.sendall(whole[start : start + 100])
        time.sleep(0.001)
    assert stepped.get(TICK).value == 2
    assert stepped.get(CHANNELS.readback_pvs[179]).value == pytest.approx(17.9)


def test_a_read_sees_the_put_before_it_and_not_the_one_after(stepped):
    """All in one write to the socket: puts, reads, a put that is refused, a filtered name."""
    filtered = SETPOINTS[1] + '.{"ts":{}}'
    stepped.create(filtered, SETPOINTS[2] + ".VAL")
    names = (*SETPOINTS[:3], filtered, SETPOINTS[2] + ".VAL")

    def put(name, value):
        return (4, struct.pack(">d", value), DOUBLE, 1, stepped.sid[name], 7)

    def read(number):
        return (15, b"", DOUBLE, 1, stepped.sid[names[number]], 50 + number)

    stepped.send(
        *(put(name, float(row)) for row, name in enumerate(SETPOINTS[:3])),
        *map(read, range(5)),
        put(SETPOINTS[0], 19.0),  # beyond the drive limit
        read(0),
        put(SETPOINTS[1], 7.0),
        read(1),
    )
    answers = []
    while len(answers) < 7:
        if (message := stepped.receive()).command == 15:
            assert (message.data_type, message.count, message.first) == (DOUBLE, 1, 1)
            answers.append((message.second - 50, struct.unpack(">d", message.payload)[0]))
    # caproto answers the filtered one, maybe later than what came after it
    assert sorted(a for a in answers if a[0] != 3) == [
        (0, 0.0),
        (0, 0.0),
        (1, 1.0),
        (1, 7.0),
        (2, 2.0),
        (4, 2.0),
    ]
    assert [value for number, value in answers if number == 3] in ([1.0], [7.0])

"""The bytes of monitors and puts, against caproto's own reader and writer."""

import caproto as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_sim_board import LATE, LAYOUT

from orbitfb.sim.access.board import Board, Entry
from orbitfb.sim.access.feed import Feed
from orbitfb.sim.access.frames import DOUBLE, TIME_DOUBLE, Frames, Monitor
from orbitfb.sim.access.puts import LARGEST_MESSAGE, array_put, leading_puts, message_end

COUNT = len(LAYOUT.readings) + len(LAYOUT.setpoints)


@pytest.fixture
def board():
    board = Board(LAYOUT, LATE)
    board.show(np.linspace(-4.0, 4.0, len(LAYOUT.readings)), LATE)
    return board


def parse(data):
    """What caproto's client reads."""
    circuit = ca.VirtualCircuit(ca.CLIENT, ("127.0.0.1", 1), 0)
    commands, missing = circuit.recv(data)
    assert missing == 16  # nothing left over but the wait for a next header
    return list(commands)


@given(
    st.lists(
        st.tuples(
            st.lists(st.integers(0, COUNT - 1), min_size=1, max_size=4, unique=True),
            st.sampled_from([DOUBLE, TIME_DOUBLE]),
        ),
        min_size=1,
        max_size=30,
    )
)
def test_a_frame_is_what_caproto_reads_as_updates(wanted):
    board = Board(LAYOUT, LATE)
    board.show(np.linspace(-4.0, 4.0, len(LAYOUT.readings)), LATE)
    monitors = [
        Monitor(np.array(places), 77 + n, 1, kind) for n, (places, kind) in enumerate(wanted)
    ]
    frames = Frames(monitors)
    frames.fill(board)
    commands = parse(frames.whole())
    assert len(commands) == len(monitors)
    for command, monitor in zip(
        commands, sorted(monitors, key=lambda monitor: int(monitor.places[0])), strict=True
    ):
        entries = [board.get(int(place)) for place in monitor.places]
        assert isinstance(command, ca.EventAddResponse)
        assert command.subscriptionid == monitor.subscription
        assert (command.data_type, command.data_count) == (
            monitor.data_type,
            len(entries),
        )
        assert command.status.code_with_severity == 1
        assert list(command.data) == [entry.value for entry in entries]
        if monitor.data_type == TIME_DOUBLE:
            assert tuple(command.metadata.stamp) == entries[0].stamp
            alarm = entries[0][2:] if len(entries) == 1 else (0, 0)
            assert (command.metadata.status, command.metadata.severity) == alarm


def test_a_part_of_a_frame_is_those_updates(board):
    frames = Frames([Monitor(np.array([index]), index, 1, TIME_DOUBLE) for index in range(COUNT)])
    frames.fill(board)
    commands = parse(frames.part(np.array([1, 4])))
    assert [command.subscriptionid for command in commands] == [1, 4]


class FakeTransport:
    def __init__(self):
        self.written = []
        self.backlog = 0
        self.closing = False

    def write(self, data):
        self.written += [command.subscriptionid for command in parse(data)]

    def get_write_buffer_size(self):
        return self.backlog

    def is_closing(self):
        return self.closing

    def taken(self):
        taken, self.written = self.written, []
        return taken


@pytest.fixture
def transport():
    return FakeTransport()


@pytest.fixture
def feed(board, transport):
    transport.wanted = True
    feed = Feed(board, transport, lambda: transport.wanted)
    for index in (8, 0, 9, 10):  # two readings, both setpoints
        feed.add(Monitor(np.array([index]), index, index, TIME_DOUBLE))
    assert transport.taken() == [8, 0, 9, 10]  # the present values, at once
    return feed


def test_a_client_gets_whole_orbits_or_none(feed, transport):
    feed.send_readings()
    assert transport.taken() == [0, 8]
    transport.backlog = 1
    feed.send_readings()
    assert transport.taken() == []
    transport.backlog = 0
    feed.send_readings()
    assert transport.taken() == [0, 8]


def test_setpoints_are_sent_once_and_never_lost(feed, transport):
    transport.backlog = 1
    feed.mark(np.array([9]))
    feed.send_setpoints()
    feed.mark(np.array([10]))
    feed.send_setpoints()
    assert transport.taken() == []
    transport.backlog = 0
    feed.send_setpoints()
    assert transport.taken() == [9, 10]
    feed.send_setpoints()
    assert transport.taken() == []


def test_silence_is_kept_until_the_client_wants_more(feed, transport):
    transport.wanted = False
    feed.send_readings()
    feed.mark(np.array([9]))
    feed.send_setpoints()
    assert transport.taken() == []
    transport.wanted = True
    feed.send_setpoints()
    assert transport.taken() == [9]


def test_nothing_is_sent_for_what_is_gone(feed, transport):
    feed.remove(8)
    feed.remove_channel(9)
    feed.remove(12345)
    feed.mark(np.array([9, 10]))
    feed.send_readings()
    feed.send_setpoints()
    assert transport.taken() == [0, 10]


def test_a_closed_connection_is_left_alone(feed, transport):
    transport.closing = True
    feed.send_readings()
    feed.add(Monitor(np.array([1]), 1, 1, DOUBLE))
    assert transport.taken() == []


def put(channel, value):
    command = ca.WriteRequest([value], ca.ChannelType.DOUBLE, 1, channel, 5)
    return b"".join([bytes(command.header), *map(bytes, command.buffers)])


@given(
    before=st.integers(0, 4),
    values=st.lists(st.floats(), max_size=20),
    after=st.sampled_from([b"", b"\0\4", put(1, 1.0)[:23], bytes(ca.EchoRequest().header)]),
)
def test_puts_are_what_caproto_writes(before, values, after):
    lead = bytes(ca.EchoRequest().header) * before
    data = lead + b"".join(put(100 + n, value) for n, value in enumerate(values)) + after
    run = leading_puts(data, len(lead))
    assert run["channel"].tolist() == list(range(100, 100 + len(values)))
    np.testing.assert_array_equal(run["value"], values)


def test_the_put_of_an_array_is_what_caproto_writes_and_nothing_else_is():
    values = [1.0, -2.5, 3e-7]
    command = ca.WriteRequest(values, ca.ChannelType.DOUBLE, 3, 44, 5)
    data = bytes(ca.EchoRequest().header) + b"".join([bytes(command.header), *command.buffers])
    channel, got = array_put(data, 16, len(data))
    assert (channel, got.tolist()) == (44, values)
    other = ca.WriteRequest(values, ca.ChannelType.FLOAT, 3, 44, 5)
    data = b"".join([bytes(other.header), *other.buffers])
    assert array_put(data, 0, len(data)) is None


def test_setpoints_that_changed_are_told_by_the_arrays_that_show_them(board):
    arrays = [np.array([7, 8]), np.array([9])]
    frames = Frames([Monitor(places, n, 1, TIME_DOUBLE) for n, places in enumerate(arrays)])
    which = np.zeros(len(board.names), dtype=bool)
    assert frames.rows(which).tolist() == []
    which[8] = True
    assert frames.rows(which).tolist() == [0]


def test_messages_end_where_their_headers_say():
    data = put(1, 1.0) + bytes(ca.EchoRequest().header)
    assert message_end(data, 0) == 24
    assert message_end(data, 24) == 40
    assert message_end(data, 40) is None
    assert message_end(data[:23], 0) is None
    long = b"\0\4\xff\xff" + bytes(12) + (1000).to_bytes(4) + bytes(4)
    assert message_end(long, 0) is None
    assert message_end(long + bytes(1000), 0) == 1024
    with pytest.raises(ca.RemoteProtocolError, match="bytes announced"):
        message_end(b"\0\4\xff\xff" + bytes(12) + (LARGEST_MESSAGE + 1).to_bytes(4) + bytes(4), 0)


def test_a_refused_setpoint_shows_its_alarm_with_the_old_value(board):
    board.set(9, Entry(1.0, LATE, 2, 2))
    frames = Frames([Monitor(np.array([9]), 1, 1, TIME_DOUBLE)])
    frames.fill(board)
    (command,) = parse(frames.whole())
    assert (command.data[0], command.metadata.status, command.metadata.severity) == (1.0, 2, 2)

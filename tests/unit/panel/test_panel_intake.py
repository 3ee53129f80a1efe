"""What a client of the panel sends is looked at before anything of it is kept."""

import struct

import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.panel.intake import AT_ONCE, STEADY, Intake

READ, WRITE, WRITE_NOTIFY = 15, 4, 19


def message(command: int, payload: bytes = b"") -> bytes:
    return struct.pack(">HHHHII", command, len(payload), 6, 1, 0, 0) + payload


def long_message(command: int, size: int) -> bytes:
    return struct.pack(">HHHHIIII", command, 0xFFFF, 6, 0, 0, 0, size, size // 8)


def intake(longest: int = 8192) -> tuple[Intake, ManualClock]:
    clock = ManualClock()
    return Intake(longest, clock), clock


@pytest.mark.parametrize("piece", [1, 7, 16, 4096])
def test_usual_messages_pass_however_they_are_cut(piece: int):
    its, _ = intake()
    stream = (message(READ) + message(WRITE, b"\0" * 24)) * 5 + long_message(WRITE, 8000)
    stream += b"\0" * 8000 + message(READ)
    for start in range(0, len(stream), piece):
        assert its.take(stream[start : start + piece]) == ""


@pytest.mark.parametrize("piece", [1, 24])
def test_a_message_of_four_gigabytes_is_refused_by_its_head(piece: int):
    its, _ = intake()
    stream = message(READ) + long_message(WRITE, 0xFFFFFFF0)
    told = [its.take(stream[start : start + piece]) for start in range(0, len(stream), piece)]
    assert told[:-1] == [""] * (len(told) - 1)
    assert told[-1] == "a message of 4294967280 bytes was announced, 8192 are read"


def test_what_looks_like_a_head_within_a_message_is_none():
    its, _ = intake()
    assert its.take(message(WRITE, long_message(WRITE, 0xFFFFFFF0))) == ""


@pytest.mark.parametrize("command", [WRITE, WRITE_NOTIFY])
def test_nobody_writes_faster_than_anybody_can_mean(command: int):
    its, clock = intake()
    assert its.take(message(command, b"\0" * 8) * AT_ONCE) == ""
    clock.advance(2.0)
    assert its.take(message(command) * int(2.0 * STEADY)) == "", "what it may keep up"
    assert "writes at once, and then 20 per second" in its.take(message(command) * 2)


def test_reads_are_not_counted():
    its, _ = intake()
    assert its.take(message(READ) * 10 * AT_ONCE) == ""

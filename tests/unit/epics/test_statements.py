"""Which events of units and limits state something new, and which only repeat."""

import ctypes

import pytest

from orbitfb.epics.libca import EventArguments
from orbitfb.epics.requests import CONTROL_RECORD
from orbitfb.epics.stated.statements import IDLE, Statements


def event(units: bytes = b"mm", high: float = 5.0, value: float = 0.0, severity: int = 0):
    """An event that libca would hand over; its memory lives as long as it does."""
    memory = ctypes.create_string_buffer(CONTROL_RECORD.itemsize)
    ctypes.c_int16.from_buffer(memory, 2).value = severity
    memory[8:16] = units.ljust(8, b"\0")
    ctypes.c_double.from_buffer(memory, CONTROL_RECORD.fields["upper_limit"][1]).value = high
    ctypes.c_double.from_buffer(memory, CONTROL_RECORD.fields["value"][1]).value = value
    arguments = EventArguments(data=ctypes.addressof(memory))
    arguments.memory = memory
    return arguments


@pytest.fixture
def statements():
    return Statements(3)


def test_the_first_event_of_a_pv_is_no_news_and_a_change_is(statements):
    assert not statements.is_new(1, event())
    assert not statements.is_new(1, event())
    assert statements.is_new(1, event(units=b"um"))
    assert statements.is_new(1, event(units=b"um", high=4.0))
    assert not statements.is_new(0, event(units=b"A"))


def test_another_value_or_alarm_is_no_statement(statements):
    statements.is_new(1, event())
    assert not statements.is_new(1, event(value=3.0, severity=2))


def test_a_pv_that_comes_back_states_what_it_has(statements):
    statements.is_new(1, event())
    statements.came(1)
    assert not statements.is_new(1, event(units=b"um"))


def test_who_repeats_more_than_edits_do_is_told_once(statements):
    for _ in range(1 + IDLE):
        statements.is_new(0, event())
        statements.is_new(1, event())
    statements.is_new(1, event())
    assert statements.repeating() == [1]
    statements.is_new(1, event())
    assert statements.repeating() == []

"""Signals while the service starts, also where a library swallows the end that they bring."""

import contextlib
import signal

import pytest

from orbitfb.app.setup.stop_signals import StopSignals
from orbitfb.core.errors import MachineError


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


def test_a_signal_ends_the_start_at_once():
    with pytest.raises(SystemExit) as ended, StopSignals():
        interrupt()
    assert ended.value.code == 130


def test_an_end_that_a_library_swallows_still_ends_the_start():
    with pytest.raises(SystemExit) as ended, StopSignals() as signals:
        with contextlib.suppress(SystemExit):
            interrupt()
        signals.hand_over()
    assert ended.value.code == 130
    assert not signals.stop.is_set()


def test_an_end_that_a_library_takes_for_a_failure_of_its_own_is_none():
    with pytest.raises(SystemExit) as ended, StopSignals():
        try:
            interrupt()
        except SystemExit:
            raise MachineError("libca cannot be loaded") from None
    assert ended.value.code == 130


def test_a_loop_that_runs_is_asked_to_stop():
    with StopSignals() as signals:
        signals.hand_over()
        interrupt()
        assert signals.stop.is_set()


def test_a_closed_window_stops_it_like_the_end_of_the_computer():
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    try:
        with StopSignals() as signals:
            signals.hand_over()
            signal.raise_signal(signal.SIGHUP)
            assert signals.stop.is_set()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_who_started_it_with_nohup_can_close_the_window():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            signals.hand_over()
            signal.raise_signal(signal.SIGHUP)
            assert not signals.stop.is_set()
    finally:
        signal.signal(signal.SIGHUP, before)

"""A trip is frozen to a file that holds exactly the right ticks; the loop goes on whatever."""

import errno
import logging
import threading

import numpy as np
import pytest
from postmortem_loop import PATIENCE, Loop, ring

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.postmortem.frozen import Trigger
from orbitfb.postmortem.log_tap import LogTap
from orbitfb.postmortem.reading import read_postmortem
from orbitfb.postmortem.recorder import MOST_WAITING
from orbitfb.postmortem.shelf import Shelf


def test_a_file_holds_exactly_the_ticks_around_the_trip(tripped):
    loop, path = tripped
    its = read_postmortem(path)
    assert (its.trigger, its.state, its.about["before"]) == ("trip", "TRIPPED", "CLOSED")
    assert its.about["tick"] == 60
    assert its.reason == "stored current 0 mA is below the 10 mA that the loop needs"
    np.testing.assert_array_equal(its.columns["tick"], np.arange(30, 71))
    assert its.columns["since_trip"][0] == pytest.approx(-3.0, abs=1e-5)
    assert its.columns["since_trip"][30] == 0.0
    assert its.columns["since_trip"][-1] == pytest.approx(1.0, abs=1e-5)
    for row, record in enumerate(loop.records[30:71]):
        assert its.states()[row] is record.state
        assert its.reasons[row] == record.reason
        np.testing.assert_array_equal(its.columns["orbit"][row], record.reading.orbit.position)
        np.testing.assert_array_equal(its.columns["readback"][row], record.reading.readback)
        for name in ("reference", "setpoints", "requested", "applied"):
            np.testing.assert_array_equal(its.columns[name][row], getattr(record, name))
        assert its.columns["phases"][row].shape == (5,)
    assert its.configuration.startswith("seed = 7")
    assert its.about["policies"] == ["inverse"] and its.about["ioc"] == "x"
    assert loop.recorder.status().written == 1 and not loop.failed


def test_nothing_is_written_without_a_trip(loop):
    loop.ticks(100, "one_nan", "missing", "good")
    loop.settle()
    assert not loop.files() and loop.recorder.status().written == 0


def test_the_tick_does_not_wait_for_a_file_and_a_second_trip_comes_through(loop, monkeypatch):
    """The disk hangs in the first file while the loop trips, is reset, and trips again."""
    release, begun = threading.Event(), threading.Event()
    put = Shelf.put

    def hanging(shelf, wall, content):
        begun.set()
        assert release.wait(PATIENCE)
        return put(shelf, wall, content)

    monkeypatch.setattr(Shelf, "put", hanging)
    loop.ticks(40)
    loop.ticks(12, "beam_lost")
    assert begun.wait(PATIENCE)
    loop.reset()
    assert loop.runner.state is LoopState.CLOSED
    loop.ticks(50)
    loop.ticks(40, "beam_lost")
    assert loop.recorder.status().written == 0
    assert loop.recorder.status().waiting == 2
    release.set()
    loop.settle()
    first, second = map(read_postmortem, loop.files())
    np.testing.assert_array_equal(first.columns["tick"], np.arange(10, 51))
    trip = second.about["tick"]
    assert trip == 40 + 12 + 2 + 50
    np.testing.assert_array_equal(second.columns["tick"], np.arange(trip - 30, trip + 11))


def test_two_trips_within_the_time_after_each_get_a_file(loop):
    loop.ticks(40)
    loop.ticks(3, "beam_lost")
    loop.reset()
    loop.ticks(30, "beam_lost")
    loop.settle()
    first, second = map(read_postmortem, loop.files())
    assert (first.about["tick"], second.about["tick"]) == (40, 45)
    assert first.columns["tick"][-1] == 50 and second.columns["tick"][-1] == 55
    assert LoopState.OPEN in first.states()


def test_the_end_of_the_loop_freezes_what_there_is(loop):
    loop.ticks(40)
    loop.ticks(4, "beam_lost")
    loop.settle()
    [path] = loop.files()
    assert read_postmortem(path).columns["tick"][-1] == 43


def test_a_loop_that_ticks_no_more_is_frozen_by_the_thread(loop):
    loop.ticks(40)
    loop.ticks(4, "beam_lost")
    loop.clock.advance(5.0)
    loop.recorder._wake.set()
    deadline = threading.Event()
    while not loop.written and not deadline.wait(0.01):
        pass
    assert [tick.record.tick for tick in loop.written[0][1].ticks] == [*range(10, 44)]


def test_a_tick_that_comes_much_later_is_not_part_of_it(loop):
    loop.ticks(40)
    loop.ticks(4, "beam_lost")
    loop.clock.advance(0.9)  # not so long that the thread takes it first
    loop.ticks(1)
    loop.settle()
    [path] = loop.files()
    assert read_postmortem(path).columns["tick"].tolist() == [*range(10, 44)]


def test_a_fault_is_frozen_too(loop):
    loop.ticks(40)
    loop.ticks(1, RuntimeError("no idea"))
    assert loop.runner.state is LoopState.FAULT
    loop.settle()
    [(_, frozen)] = loop.written
    assert frozen.cause.trigger is Trigger.FAULT and "no idea" in frozen.cause.reason


def test_an_operator_gets_the_last_seconds_at_once(loop):
    loop.ticks(50)
    path = loop.recorder.request("asked by me").result(PATIENCE)
    its = read_postmortem(path)
    assert (its.trigger, its.state, its.reason) == ("command", "CLOSED", "asked by me")
    np.testing.assert_array_equal(its.columns["tick"], np.arange(19, 50))


def test_before_the_first_tick_there_is_nothing_to_keep(loop):
    its = read_postmortem(loop.recorder.request("too early").result(PATIENCE))
    assert its.rows == 0 and its.about["tick"] == -1


def test_a_full_disk_is_counted_and_told_and_the_loop_goes_on(loop, monkeypatch):
    def full(descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    loop.ticks(40)
    loop.ticks(30, "beam_lost")
    asked = loop.recorder.request("me")
    with pytest.raises(ControlError, match="No space left on device"):
        asked.result(PATIENCE)
    status = loop.recorder.status()
    assert (status.written, status.failed) == (0, 2) and "No space left" in status.problem
    assert len(loop.failed) == 2 and "make room" in loop.failed[0]
    assert list(loop.directory.iterdir()) == []  # no half a file either
    monkeypatch.undo()
    loop.reset()
    loop.ticks(30, "beam_lost")
    loop.settle()
    assert len(loop.files()) == 1 and loop.recorder.status().problem == ""


def test_a_directory_that_cannot_be_made_is_the_same(tmp_path):
    (tmp_path / "file").write_text("in the way")
    loop = Loop(tmp_path / "file/postmortem")
    loop.ticks(40)
    loop.ticks(30, "beam_lost")
    loop.settle()
    assert loop.recorder.status().failed == 1 and loop.runner.state is LoopState.TRIPPED


def test_more_than_the_disk_takes_are_given_up_not_piled_up(loop, monkeypatch):
    release = threading.Event()
    monkeypatch.setattr(Shelf, "put", lambda *_: release.wait(PATIENCE) and loop.directory / "x.h5")
    loop.ticks(5)
    asked = [loop.recorder.request(str(number)) for number in range(MOST_WAITING + 5)]
    refused = [its for its in asked if its.done() and its.exception()]
    assert len(refused) in (4, 5)  # one may be in the writer's hands
    assert loop.recorder.status().failed == len(refused)
    release.set()


def test_the_oldest_files_are_removed_and_said(tmp_path):
    loop = Loop(tmp_path / "postmortem", kept_files=2)
    loop.ticks(10)
    made = [loop.recorder.request(str(number)).result(PATIENCE) for number in range(4)]
    loop.settle()
    assert loop.files() == made[2:]
    assert loop.removed == [[made[0]], [made[1]]]


def test_size_counts_too_but_the_newest_stays(tmp_path):
    loop = Loop(tmp_path / "postmortem", kept_megabytes=1e-3)
    loop.ticks(10)
    made = [loop.recorder.request(str(number)).result(PATIENCE) for number in range(3)]
    loop.settle()
    assert loop.files() == made[2:]


def test_a_fast_loop_keeps_a_bounded_number_of_ticks(tmp_path):
    loop = Loop(tmp_path / "postmortem", before=60.0, most_ticks=100)
    loop.ticks(300)
    its = read_postmortem(loop.recorder.request("me").result(PATIENCE))
    loop.settle()
    np.testing.assert_array_equal(its.columns["tick"], np.arange(200, 300))


def test_what_a_killed_writer_left_is_swept_away(tmp_path):
    directory = tmp_path / "postmortem"
    directory.mkdir()
    (directory / ".unfinished-1").write_bytes(b"half")
    loop = Loop(directory)
    loop.settle()
    assert list(directory.iterdir()) == []


def test_swaps_and_whatever_is_logged_are_in_the_file(loop):
    tap = LogTap(loop.recorder.tell)
    logger = logging.getLogger("orbitfb.test_postmortem")
    try:
        loop.ticks(40)
        loop.slot.swap(ring.InversePolicy("another"))
        logger.warning({"event": "command_given", "command": "reset", "user": "kim"})
        logger.error("a library says %d", 7)
        loop.ticks(30, "beam_lost")
    finally:
        tap.close()
    logger.error("after it was closed")
    loop.settle()
    [path] = loop.files()
    its = read_postmortem(path)
    assert its.about["policies"] == ["inverse", "another"]
    told = [(event.level, event.name) for event in its.events]
    assert ("warning", "command_given") in told
    assert ("error", "orbitfb.test_postmortem") in told
    assert '"user": "kim"' in its.events[0].fields and "says 7" in its.events[1].fields
    assert len(its.events) == 2

"""The ring buffer: what a snapshot holds, and that a busy writer cannot tear it."""

import sys
import threading

import numpy as np
import pytest
from history_records import check_row, eventful_run, make_channels, make_record

from orbitfb.core.signals import Orbit, Reading
from orbitfb.history.buffer import History


def filled(ticks, capacity=100):
    history = History(make_channels(), capacity)
    for tick in ticks:
        history(make_record(tick))
    return history


def test_a_transition_joins_a_tick_and_the_next_one():
    snapshot = filled(range(30)).snapshot()
    assert list(snapshot.tick) == list(range(29))
    for row in range(29):
        check_row(snapshot, row)
    assert snapshot.usable.all()
    assert snapshot.closed.all()


@pytest.mark.parametrize("ticks", [0, 1])
def test_too_few_ticks_make_no_transition(ticks):
    snapshot = filled(range(ticks)).snapshot()
    assert len(snapshot) == 0
    assert snapshot.orbit.shape == (0, 5)


def test_only_the_latest_are_kept():
    history = filled(range(1000), capacity=40)
    snapshot = history.snapshot()
    assert len(history) == 40
    assert list(snapshot.tick) == list(range(960, 999))
    for row in range(39):
        check_row(snapshot, row)


def test_a_part_can_be_asked_for():
    history = filled(range(300))
    assert list(history.snapshot(last=5).tick) == [294, 295, 296, 297, 298]
    assert list(history.snapshot(since_tick=297).tick) == [297, 298]
    assert list(history.snapshot(last=5, since_tick=290).tick) == [294, 295, 296, 297, 298]
    assert len(history.snapshot(since_tick=299)) == 0
    assert history.snapshot(since_tick=-1).tick[0] == 200


def test_later_ticks_do_not_change_a_snapshot():
    history = filled(range(30), capacity=20)
    snapshot = history.snapshot()
    before = snapshot.orbit.copy()
    for tick in range(30, 500):
        history(make_record(tick))
    np.testing.assert_array_equal(snapshot.orbit, before)


def test_what_breaks_the_sequence_makes_a_transition_unusable():
    history = History(make_channels(), 100)
    for record in eventful_run():
        history(record)
    snapshot = history.snapshot()
    unusable = set(snapshot.tick[~snapshot.usable])
    # no orbit at 7; two missed before 13; a write that left after the next stamp; tick 50 lost
    assert unusable == {6, 7, 12, 30, 49}
    assert set(snapshot.tick[~snapshot.closed]) == {7, 20}
    assert np.isnan(snapshot.orbit[7]).all()
    assert not snapshot.valid[6].any()
    assert np.isnan(snapshot.auxiliary["current"][7])
    assert snapshot.policy_id[41] == "golden µ"
    assert set(snapshot.tick[snapshot.starts()]) == {0, 7, 8, 13, 31, 51}


def test_a_bpm_counts_only_if_it_is_valid_before_and_after():
    history = History(make_channels(), 10)
    for tick, bad in ((0, 1), (1, 3), (2, 3)):
        record = make_record(tick)
        orbit = record.reading.orbit
        valid = np.arange(5) != bad
        position = np.where(valid, orbit.position, np.nan)
        reading = Reading(
            Orbit(position, valid, orbit.time), record.reading.readback, {}, record.reading.received
        )
        history(make_record(tick, reading=reading))
    snapshot = history.snapshot()
    assert snapshot.valid.tolist() == [[1, 0, 1, 0, 1], [1, 1, 1, 0, 1]]


def test_a_slow_channel_that_comes_late_is_nan_before():
    history = History(make_channels(), 10)
    for tick in range(3):
        history(make_record(tick, reading=None))
    for tick in range(3, 6):
        history(make_record(tick))
    current = history.snapshot().auxiliary["current"]
    assert np.isnan(current[:3]).all()
    assert np.isfinite(current[3:]).all()


def assert_whole(snapshot):
    """See that every number of every row belongs to the row's tick."""
    for number, name in enumerate(
        ("orbit", "readback", "reference", "setpoints", "requested", "dither", "applied")
    ):
        column = getattr(snapshot, name)
        whole = 1000.0 * snapshot.tick[:, None] + 100.0 * number + np.arange(column.shape[1])
        np.testing.assert_array_equal(column, whole, name)
    assert np.all(np.diff(snapshot.tick) == 1)
    assert snapshot.usable.all()


@pytest.mark.parametrize("ticks_per_column", [1, 3, 5, 100])
def test_rows_overwritten_while_they_are_copied_are_left_out(monkeypatch, ticks_per_column):
    """The writer goes on between the copies of any two columns, up to lapping the reader."""
    history = filled(range(150), capacity=40)
    ticks = iter(range(150, 10**6))
    take = np.take

    def take_slowly(*args, **options):
        for _ in range(ticks_per_column):
            history(make_record(next(ticks)))
        return take(*args, **options)

    monkeypatch.setattr(np, "take", take_slowly)
    snapshot = history.snapshot()
    assert_whole(snapshot)
    if ticks_per_column <= 3:
        assert len(snapshot) == 39  # the spare slots were enough
    if ticks_per_column == 5:
        assert 0 < len(snapshot) < 39


def test_snapshots_are_whole_while_the_writer_races_on():
    """A writer without pause against a reader, with a thread switch as often as can be."""
    history = History(make_channels(), 20)
    records = [make_record(tick) for tick in range(6000)]
    done = threading.Event()

    def write():
        for record in records:
            history(record)
        done.set()

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    writer = threading.Thread(target=write)
    rows = snapshots = 0
    try:
        writer.start()
        while not done.is_set():
            snapshot = history.snapshot()
            assert_whole(snapshot)
            snapshots += 1
            rows += len(snapshot)
    finally:
        sys.setswitchinterval(interval)
        writer.join()
    assert snapshots > 5
    assert rows > 50

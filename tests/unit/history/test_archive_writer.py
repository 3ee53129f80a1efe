"""The archive's thread: the loop never waits, and nothing is lost without being counted."""

import fcntl
from collections import deque

from history_records import (
    assert_same,
    buffered,
    eventful_run,
    make_channels,
    make_record,
)

from orbitfb.history.archive import ArchiveSettings, ArchiveWriter, read_archive
from orbitfb.history.recorder import Recorder

QUICK = ArchiveSettings(flush_interval=0.001, retry_interval=0.001, segment_megabytes=1.0)


def test_the_writer_loses_nothing_at_its_end(tmp_path):
    records = eventful_run()
    writer = ArchiveWriter(tmp_path / "a", make_channels(), ArchiveSettings())
    for record in records:
        writer(record)
    writer.close()
    assert_same(read_archive(tmp_path / "a"), buffered(records))
    status = writer.status()
    assert (status.written, status.dropped, status.waiting, status.problem) == (59, 0, 0, "")
    with (tmp_path / "a" / ".writer").open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # it has let go


def test_a_full_queue_drops_counts_and_never_waits(tmp_path):
    settings = ArchiveSettings(flush_interval=1.0, queue=10)
    writer = ArchiveWriter(tmp_path / "a", make_channels(), settings)
    for tick in range(30):
        writer(make_record(tick))
    assert writer.status().dropped == 20
    writer.close()
    assert list(read_archive(tmp_path / "a").tick) == list(range(9))


def test_a_disk_that_refuses_is_told_once_and_tried_again(tmp_path, monkeypatch):
    told, failing, attempts = [], True, deque()

    def write(self, queue):
        attempts.append(1)
        if failing:
            raise OSError(28, "No space left on device")
        return plain(self, queue)

    plain = Recorder.write
    monkeypatch.setattr(Recorder, "write", write)
    writer = ArchiveWriter(tmp_path / "a", make_channels(), QUICK, told.append)
    for tick in range(20):
        writer(make_record(tick))
    while len(attempts) < 5:
        writer._stop.wait(0.001)
    assert "No space left" in writer.status().problem
    assert writer.status().dropped == 0
    failing = False
    while writer.status().written < 20:
        writer._stop.wait(0.001)
    writer.close()
    assert writer.status().problem == ""
    assert len(told) == 1
    assert len(read_archive(tmp_path / "a")) == 19


def test_a_record_that_fits_no_column_does_not_stop_the_archive(tmp_path):
    told = []
    writer = ArchiveWriter(tmp_path / "a", make_channels(), QUICK, told.append)
    writer(make_record(0, bpms=7))
    while not told:
        writer._stop.wait(0.001)
    for tick in range(1, 5):
        writer(make_record(tick))
    writer.close()
    assert writer.status().dropped == 1
    assert len(read_archive(tmp_path / "a")) == 3

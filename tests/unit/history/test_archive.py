"""The archive: what is written is read back, and neither disk nor file can do harm."""

import fcntl
import os
import shutil
from collections import deque

import h5py
import numpy as np
import pytest
from history_records import assert_same, eventful_run, make_channels, make_record

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import ArchiveError, OwnershipError
from orbitfb.history.archive import ArchiveSettings, ArchiveWriter, read_archive
from orbitfb.history.buffer import History
from orbitfb.history.recorder import Recorder

MANY = ArchiveSettings(segment_megabytes=1.0, compress=False)


class Archive:
    """A recorder without its thread."""

    def __init__(self, directory, settings=MANY, channels=None, clock=None):
        self.directory = directory
        self.channels = channels or make_channels()
        self.clock = clock or ManualClock()
        self.recorder = Recorder(directory, self.channels, settings, self.clock)

    def write(self, records):
        queue = deque(records)
        while self.recorder.write(queue):
            pass

    def tidy(self):
        while self.recorder.tidy():
            pass

    def segments(self):
        return sorted(self.directory.glob("*.h5"))


@pytest.fixture
def archive(tmp_path):
    made = Archive(tmp_path / "archive")
    yield made
    made.recorder.close()


def buffered(records):
    history = History(make_channels(), 10_000)
    for record in records:
        history(record)
    return history.snapshot()


def test_the_archive_reads_back_what_the_buffer_holds(archive):
    records = eventful_run()
    archive.write(records)
    assert_same(read_archive(archive.directory), buffered(records))


def test_compression_changes_no_number(archive, tmp_path):
    records = eventful_run()
    archive.write(records)
    archive.recorder.close()
    raw = [path.read_bytes() for path in archive.segments()]
    before = read_archive(archive.directory)
    again = Archive(archive.directory, ArchiveSettings())  # the next run finds it and compresses
    again.tidy()
    assert_same(read_archive(archive.directory), before)
    packed = [path.read_bytes() for path in archive.segments()]
    assert len(packed) == len(raw)
    assert sum(map(len, packed)) < 0.2 * sum(map(len, raw))
    with h5py.File(archive.segments()[-1]) as file:
        assert file["orbit"].compression == "gzip"
        assert file["orbit"].attrs["units"] == "m"
        assert file["setpoints"].attrs["units"] == "A"
        assert h5py.check_enum_dtype(file["state"].dtype)["CLOSED"] == file["state"][0]
    again.recorder.close()


def test_many_segments_read_as_one(archive, monkeypatch):
    monkeypatch.setattr("orbitfb.history.recorder.row_bytes", lambda _: 50_000)  # 20 rows each
    records = [make_record(tick) for tick in range(95)]
    archive.write(records)
    assert len(archive.segments()) == 5
    assert_same(read_archive(archive.directory), buffered(records))
    assert_same(read_archive(archive.directory, last=30), buffered(records[-31:]))
    assert_same(read_archive(archive.segments()[1]), buffered(records[20:40]))


def test_the_names_of_segments_sort_in_the_order_of_writing(archive):
    archive.write([make_record(tick) for tick in range(5)])
    archive.clock.advance(700.0)
    archive.write([make_record(tick) for tick in range(5, 10)])
    archive.clock.advance(-3600.0)  # the wall clock was set back; the age is negative now
    archive.recorder._finish()
    archive.write([make_record(tick) for tick in range(10, 15)])
    assert len(archive.segments()) == 3
    assert list(read_archive(archive.directory).tick) == list(range(14))


def test_a_run_does_not_continue_into_the_next_one(archive):
    archive.write([make_record(tick) for tick in range(5)])
    archive.recorder.close()
    again = Archive(archive.directory)
    again.write([make_record(tick) for tick in range(5, 10)])
    read = read_archive(archive.directory)
    again.recorder.close()
    assert list(read.tick) == [0, 1, 2, 3, 5, 6, 7, 8]
    assert list(np.flatnonzero(read.starts())) == [0, 4]


def test_a_tick_that_was_dropped_makes_its_transition_unusable(archive):
    archive.write([make_record(tick) for tick in (0, 1, 2, 5, 6)])
    read = read_archive(archive.directory)
    assert read.usable.tolist() == [True, True, False, True]


def test_what_is_marked_is_on_disk_before_anything_is_closed(archive):
    archive.write([make_record(tick) for tick in range(10)])
    assert len(read_archive(archive.directory)) == 9  # while the writer holds it open
    with h5py.File(archive.segments()[-1], "r") as file:  # and to any HDF5 program
        assert file["whole"][:].sum() == 10


def test_rows_that_were_written_but_not_marked_are_not_read(archive, monkeypatch):
    archive.write([make_record(tick) for tick in range(10)])

    def die(_):
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fdatasync", die)
        with pytest.raises(OSError, match="Input/output"):
            archive.write([make_record(tick) for tick in range(10, 20)])
    assert list(read_archive(archive.directory).tick) == list(range(9))
    archive.write([make_record(tick) for tick in range(10, 20)])
    assert list(read_archive(archive.directory).tick) == list(range(19))


def test_a_kill_between_any_two_writes_leaves_the_rows_before_whole(archive, tmp_path, monkeypatch):
    archive.write([make_record(tick) for tick in range(10)])
    archive.write([make_record(tick) for tick in range(10, 13)])
    path, copy, lengths = archive.segments()[0], tmp_path / "copy.h5", []
    pwrite = os.pwrite

    def write_and_look(descriptor, content, position):
        # Half a write first: a kill can cut one, at a page's border.
        half = pwrite(descriptor, bytes(content)[: max(1, len(content) // 2)], position)
        shutil.copy(path, copy)
        read = read_archive(copy)
        assert_same(read, buffered([make_record(tick) for tick in range(len(read) + 1)]))
        lengths.append(len(read))
        return half

    monkeypatch.setattr(os, "pwrite", write_and_look)
    archive.write([make_record(tick) for tick in range(13, 17)])
    assert set(lengths[:-3]) == {12}
    assert lengths[-3:] == [14, 15, 16]  # the marks: 2 of 4, 1 of 2, the last one


def test_the_oldest_segments_go_when_there_are_too_many_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr("orbitfb.history.recorder.row_bytes", lambda _: 20_000)  # 50 rows each
    archive = Archive(tmp_path / "a", MANY.model_copy(update={"keep_gigabytes": 2e-4}))
    archive.write([make_record(tick) for tick in range(2000)])
    archive.recorder.close()
    used = sum(512 * path.stat().st_blocks for path in archive.segments())
    assert used < 3e5
    assert 1 < len(archive.segments()) < 20
    assert read_archive(archive.directory).tick[-1] == 1998


def test_two_writers_of_one_directory_are_refused(archive):
    with pytest.raises(OwnershipError, match="another process writes"):
        Archive(archive.directory)


def test_a_directory_that_cannot_be_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArchiveError, match="cannot be used"):
        Archive(tmp_path / "file")


def test_another_ring_is_refused(archive):
    archive.write([make_record(tick) for tick in range(5)])
    for other, words in (
        (make_channels(prefix="S"), "BPM0 instead of SBPM0"),
        (make_channels(bpms=6), "5 of 6"),
    ):
        with pytest.raises(ArchiveError, match=words):
            read_archive(archive.directory, other)


def two_segments(archive):
    archive.write([make_record(tick) for tick in range(5)])
    archive.recorder._finish()
    archive.write([make_record(tick) for tick in range(5, 10)])
    return archive.segments()


@pytest.mark.parametrize("kept", [0, 1, 100, 3000, 0.5, -1])
def test_a_truncated_segment_is_named_and_can_be_skipped(archive, kept):
    first, second = two_segments(archive)
    size = second.stat().st_size
    os.truncate(second, int(kept * size) if 0 < kept < 1 else kept % size)
    with pytest.raises(ArchiveError, match=second.name):
        read_archive(archive.directory)
    heard = []
    read = read_archive(archive.directory, on_corrupt=heard.append)
    assert list(read.tick) == [0, 1, 2, 3]
    assert len(heard) == 1
    assert list(read_archive(first).tick) == [0, 1, 2, 3]


def test_damage_to_the_bookkeeping_is_found_or_touches_nothing(archive):
    """Flip bytes everywhere but in the rows themselves."""
    archive.write([make_record(tick) for tick in range(5)])
    path = archive.segments()[0]
    before, content = read_archive(path), path.read_bytes()
    bookkeeping = np.ones(len(content), dtype=bool)

    def leave_out(_, found):
        if isinstance(found, h5py.Dataset):
            start = found.id.get_offset()
            bookkeeping[start : start + found.nbytes] = False

    with h5py.File(path) as file:
        file.visititems(leave_out)
    rng = np.random.default_rng(1)
    refused = 0
    for position in rng.choice(np.flatnonzero(bookkeeping), 120, replace=False):
        damaged = bytearray(content)
        damaged[position] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            assert_same(read_archive(path), before)
        except ArchiveError as error:
            assert path.name in str(error)
            refused += 1
    assert refused > 60


def rewritten(path, change):
    with h5py.File(path, "r+") as file:
        change(file)


def swap_column(name, **made):
    def change(file):
        del file[name]
        file.create_dataset(name, **made)

    return change


def set_version(file):
    file.attrs["schema_version"] = 2


def link_outside(file):
    del file["orbit"]
    file["orbit"] = h5py.ExternalLink("/etc/hostname", "orbit")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (set_version, "schema_version 2, this program reads 1"),
        (link_outside, "no dataset 'orbit'"),
        (swap_column("orbit", shape=(3, 5), dtype="f8"), "'orbit' has shape"),
        (swap_column("tick", shape=(10**12,), dtype="i8", chunks=(1000,)), "'tick' has shape"),
        (swap_column("whole", shape=(10**12,), dtype="u1", chunks=(1000,)), "'whole' has shape"),
        (swap_column("whole", shape=(9,), dtype="u1", chunks=(9,), fletcher32=True), "filter"),
        (swap_column("orbit", data=h5py.Empty("f8")), "shape"),
        (lambda file: file.__delitem__("auxiliary"), "cannot be read"),
        (lambda file: file.__delitem__("channels"), "channels/bpms"),
    ],
)
def test_a_strange_segment_is_refused_before_it_is_read(archive, change, words):
    archive.write([make_record(tick) for tick in range(5)])
    rewritten(archive.segments()[0], change)
    with pytest.raises(ArchiveError, match=words):
        read_archive(archive.directory)


def test_no_more_is_read_than_is_allowed(archive):
    archive.write([make_record(tick) for tick in range(100)])
    with pytest.raises(ArchiveError, match="allowed"):
        read_archive(archive.directory, largest=1000, on_corrupt=lambda _: None)


def test_no_archive_is_an_error(tmp_path):
    with pytest.raises(ArchiveError, match="there is no archive"):
        read_archive(tmp_path / "nowhere")
    with pytest.raises(ArchiveError, match="no segment"):
        read_archive(tmp_path)


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


def test_a_directory_that_goes_away_comes_back(archive):
    archive.write([make_record(tick) for tick in range(5)])
    shutil.rmtree(archive.directory)
    with pytest.raises(FileNotFoundError):
        archive.write([make_record(tick) for tick in range(5, 8)])
    archive.write([make_record(tick) for tick in range(5, 10)])
    assert list(read_archive(archive.directory).tick) == [5, 6, 7, 8]
    with pytest.raises(OwnershipError):
        Archive(archive.directory)  # the new directory is locked as well


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

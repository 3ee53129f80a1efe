"""The archive: what is written is read back, whatever happens to the writer."""

import os
import shutil
from dataclasses import replace

import h5py
import numpy as np
import pytest
from history_records import (
    MANY,
    Archive,
    assert_same,
    buffered,
    eventful_run,
    make_channels,
    make_record,
)

from orbitfb.core.errors import ArchiveError, OwnershipError
from orbitfb.history.archive import ArchiveSettings, read_archive
from orbitfb.history.verify import read_segment


@pytest.fixture
def archive(tmp_path):
    made = Archive(tmp_path / "archive")
    yield made
    made.recorder.close()


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


def test_planes_of_several_sizes_are_kept_also_by_the_tidying(tmp_path):
    counts = {"bpm_counts": (3, 2), "corrector_counts": (1, 3)}
    channels = replace(make_channels(), planes="xy", **counts)
    archive = Archive(tmp_path / "archive", MANY, channels)
    archive.write(eventful_run())
    archive.recorder.close()
    again = Archive(archive.directory, ArchiveSettings(), channels)
    again.tidy()
    again.recorder.close()
    path = archive.segments()[0]
    parts = read_segment(path, 2**30).channels.corrector_parts
    assert parts == {"x": slice(0, 1), "y": slice(1, 4)}
    for wrong in ([3, 3], [5], [0, 5], [[3, 2]], [3.0, 2.0]):
        with h5py.File(path, "a") as file:
            file.attrs["bpm_counts"] = np.array(wrong)
        with pytest.raises(ArchiveError, match="bpm_counts"):
            read_segment(path, 2**30)


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


def test_a_directory_that_goes_away_comes_back(archive):
    archive.write([make_record(tick) for tick in range(5)])
    shutil.rmtree(archive.directory)
    with pytest.raises(FileNotFoundError):
        archive.write([make_record(tick) for tick in range(5, 8)])
    archive.write([make_record(tick) for tick in range(5, 10)])
    assert list(read_archive(archive.directory).tick) == [5, 6, 7, 8]
    with pytest.raises(OwnershipError):
        Archive(archive.directory)  # the new directory is locked as well

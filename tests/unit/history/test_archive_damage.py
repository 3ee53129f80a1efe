"""Reading segments that are damaged, foreign or made up."""

import os

import h5py
import numpy as np
import pytest
from history_records import (
    Archive,
    assert_same,
    make_channels,
    make_record,
)

from orbitfb.core.errors import ArchiveError
from orbitfb.history.archive import read_archive


@pytest.fixture
def archive(tmp_path):
    made = Archive(tmp_path / "archive")
    yield made
    made.recorder.close()


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


def test_a_foreign_file_is_told_to_be_no_archive(archive):
    archive.write([make_record(tick) for tick in range(5)])
    with h5py.File(archive.directory / "foreign.h5", "w") as file:
        file["orbit"] = np.zeros(3)
    with pytest.raises(ArchiveError, match=r"foreign\.h5 is no segment of an archive of orbitfb"):
        read_archive(archive.directory)

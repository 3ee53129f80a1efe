"""A full disk, again and again: HDF5 never meets it, so the process lives on."""

import errno
import os
import subprocess
import sys

import h5py
import numpy as np
import pytest
from history_records import Archive, assert_same, buffered, eventful_run

from orbitfb.history import sink as module
from orbitfb.history.archive import ArchiveSettings, read_archive
from orbitfb.history.sink import Sink

_FULL_AGAIN_AND_AGAIN = """
import random, resource, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from history_records import Archive, make_record
from orbitfb.history.archive import ArchiveSettings, read_archive
chance = random.Random(1)
archive = Archive(Path(sys.argv[1]), ArchiveSettings(segment_megabytes=1.0))
refused = tick = 0
def attempt(work, *what):
    global refused
    try:
        work(*what)
    except OSError:
        refused += 1
for _ in range(25):
    room = chance.choice((1, 512, 2048, 6000, 20000))
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))
    for _ in range(3):
        attempt(archive.write, [make_record(tick := tick + 1)])
        attempt(archive.tidy)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)
    archive.write([make_record(tick := tick + 1)])
archive.recorder.close()
print(refused, len(read_archive(Path(sys.argv[1]))))
"""


def test_the_process_survives_a_disk_that_is_full_again_and_again(tmp_path):
    here = os.path.dirname(__file__)
    command = [sys.executable, "-c", _FULL_AGAIN_AND_AGAIN, str(tmp_path / "a"), here]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    refused, read = map(int, done.stdout.split())
    assert refused > 50
    assert read >= 24


@pytest.mark.parametrize("good", [0, 1, 3, 8, 20])
def test_compressing_on_a_full_disk_leaves_the_segment_and_nothing_open(
    tmp_path, monkeypatch, good
):
    records = eventful_run()
    first = Archive(tmp_path / "a", ArchiveSettings(compress=False))
    first.write(records)
    first.recorder.close()
    again = Archive(tmp_path / "a", ArchiveSettings())
    before = h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE)
    left = good

    def refuse(descriptor, view, position):
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        plain(descriptor, view, position)

    plain = module.write_all
    monkeypatch.setattr(module, "write_all", refuse)
    with pytest.raises(OSError, match="No space left"):
        again.tidy()
    again.recorder.close()
    assert h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE) == before
    assert not list((tmp_path / "a").glob(".unfinished-*"))
    assert_same(read_archive(tmp_path / "a"), buffered(records))


@pytest.mark.parametrize("good", [0, 2, 5])
def test_a_sink_reads_back_what_the_disk_refused(tmp_path, monkeypatch, good):
    chance, calls = np.random.default_rng(good), iter(range(1000))

    def refuse(descriptor, view, position):
        if next(calls) >= good:
            raise OSError(errno.ENOSPC, "No space left on device")
        plain(descriptor, view, position)

    plain = module.write_all
    monkeypatch.setattr(module, "write_all", refuse)
    sink, expected = Sink(tmp_path / "f"), bytearray(20_000)
    for _ in range(10):
        start, data = int(chance.integers(15_000)), chance.bytes(int(chance.integers(1, 5_000)))
        sink.seek(start)
        sink.write(data)
        expected[start : start + len(data)] = data
    size = sink.truncate(20_000)
    sink.seek(0)
    assert sink.read(size) == bytes(expected)
    with pytest.raises(OSError, match="No space left"):
        sink.check()
    sink.close_descriptor()

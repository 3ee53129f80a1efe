"""An archive whose writer is killed at any moment: it opens, and at most a second is missing."""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from orbitfb.core.signals import Channels
from orbitfb.history.archive import ArchiveSettings, ArchiveWriter, read_archive

RATE = 100.0

WRITER = """
import sys, time
from pathlib import Path
import numpy as np
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.history.archive import ArchiveSettings, ArchiveWriter

N = 180
names = tuple(f"C{i}" for i in range(N))
channels = Channels("x", names, names, names, names, names)
settings = ArchiveSettings(segment_megabytes=float(sys.argv[2]))
writer = ArchiveWriter(Path(sys.argv[1]), channels, settings)
valid = np.ones(N, dtype=bool)
tick, begin = 0, time.monotonic()
while True:
    vector = tick + np.arange(N) / 1000.0
    now = time.time()
    reading = Reading(Orbit(vector, valid, now), vector, {"current": float(tick)}, now)
    writer(
        TickRecord(
            tick, LoopState.CLOSED, "", reading, vector, vector, vector, vector, vector, 1.0, now,
            f"svd-{tick // 100}", Phases(0.0, 0.0, 0.0, 0.0, 0.0), 0.001, 0,
        )
    )
    print(tick, flush=True)
    tick += 1
    time.sleep(max(0.0, begin + tick / float(sys.argv[3]) - time.monotonic()))
"""


def run_and_kill(directory, megabytes, lifetime):
    """Let a writer work for a while after its first tick; give the last tick it handed over."""
    with (directory / "ticks").open("w+") as ticks:
        process = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(directory / "archive"), str(megabytes), str(RATE)],
            stdout=ticks,
        )
        try:
            deadline = time.monotonic() + 30.0
            while not (directory / "ticks").stat().st_size:
                assert process.poll() is None
                assert time.monotonic() < deadline
                time.sleep(0.01)
            time.sleep(lifetime)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        ticks.seek(0)
        return int(ticks.read().split("\n")[-2])


def check(archive, handed_over):
    """See that every file opens by itself and that rows are whole, in order and recent."""
    for path in archive.glob("*.h5"):
        with h5py.File(path, "r") as file:
            assert file["orbit"].attrs["units"] == "m"
    if handed_over < RATE:
        return  # younger than a second: all of it may be missing
    read = read_archive(archive)
    np.testing.assert_array_equal(read.tick, np.arange(len(read)))
    vectors = read.tick[:, None] + np.arange(180) / 1000.0
    for name in ("orbit", "reference", "setpoints", "requested", "dither", "applied", "readback"):
        np.testing.assert_array_equal(getattr(read, name), vectors, name)
    np.testing.assert_array_equal(read.auxiliary["current"], read.tick)
    assert read.usable.all()
    last_on_disk = int(read.tick[-1]) + 1
    assert handed_over - last_on_disk <= 1.0 * RATE


@pytest.mark.system
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 12))]
)
def test_a_killed_writer_leaves_an_archive_that_opens(tmp_path: Path, seed: int):
    """Small segments, so that the kill also meets the change of segment and the compression."""
    draw = random.Random(seed)
    handed_over = run_and_kill(tmp_path, draw.choice([1, 2, 64]), draw.uniform(0.05, 4.0))
    archive = tmp_path / "archive"
    check(archive, handed_over)

    names = tuple(f"C{i}" for i in range(180))
    channels = Channels("x", names, names, names, names, names)
    # The next run takes the directory over and packs what the killed one left.
    following = ArchiveWriter(archive, channels, ArchiveSettings(flush_interval=0.1))
    deadline = time.monotonic() + 20.0
    while list(archive.glob(".unfinished-*")) or any(map(is_raw, archive.glob("*.h5"))):
        assert time.monotonic() < deadline
        time.sleep(0.1)
    following.close()
    check(archive, handed_over)


def is_raw(path: Path) -> bool:
    try:
        with h5py.File(path, "r") as file:
            return not file.attrs["compressed"]
    except FileNotFoundError:  # it held no row and was removed between listing and opening
        return False

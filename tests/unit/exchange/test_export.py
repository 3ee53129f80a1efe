"""What is written for other programs, read by them; and the way back."""

import contextlib
import csv
import json
import resource
from collections import deque

import h5py
import numpy as np
import pyarrow.parquet
import pytest
import scipy.io
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import ArchiveError, ExchangeError, StoreError
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.exchange.orbits.parquet import export_archive
from orbitfb.history.recorder import Recorder
from orbitfb.history.settings import ArchiveSettings
from orbitfb.measure.response_file import read_response
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()
CHANNELS = RING.channels("x")
LABELS = [f"{name}:x" for name in CHANNELS.bpms], [f"{name}:x" for name in CHANNELS.correctors]
BPMS, CORRECTORS = ("B1", "B2", "B3"), ("C1", "C2")
SMALL = Channels("x", BPMS, CORRECTORS, BPMS, CORRECTORS, CORRECTORS)


@pytest.fixture
def learned(tmp_path, monkeypatch):
    """A store with an active policy, and its R̂ and covariance."""
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(2)
    matrix = response(RING, "x") * (1 + 0.05 * rng.standard_normal((180, 180)))
    root = 1e-6 * rng.standard_normal((180, 180))
    policy = SvdPolicy(matrix, SvdSettings(), covariance=root @ root.T)
    store = PolicyStore(tmp_path / "orbitfb-data/policies")
    store.activate(store.save(policy, CHANNELS))
    return policy.policy_id, matrix, policy.covariance


def run(*arguments):
    assert app([*map(str, arguments)], standalone_mode=False) in (None, 0)


def test_r_as_csv(learned):
    run("export", "response", "-o", "r.csv")
    with open("r.csv", newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["R [m/A]", *LABELS[1]]
    assert [row[0] for row in rows[1:]] == LABELS[0]
    assert np.array_equal(np.array([row[1:] for row in rows[1:]], dtype=float), learned[1])


def test_r_as_hdf5(learned):
    run("export", "response", learned[0], "-o", "r.h5")
    with h5py.File("r.h5") as file:
        assert np.array_equal(file["response"], learned[1])
        assert np.array_equal(file["covariance"], learned[2])
        assert file["response"].attrs["units"] == "m/A"
        assert [name.decode() for name in file["bpms"]] == LABELS[0]
        assert file.attrs["origin"] == learned[0]


def test_r_as_matlab(learned):
    run("export", "response", "-o", "r.mat")
    struct = scipy.io.loadmat("r.mat", squeeze_me=True)["R"][()]
    assert np.array_equal(struct["response"], learned[1])
    assert np.array_equal(struct["covariance"], learned[2])
    assert str(struct["units"]) == "m/A"
    assert list(struct["correctors"]) == LABELS[1]


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("r.csv", ()),
        ("r.h5", ("--matrix", "response", "--bpm-names", "bpms", "--corrector-names",
                  "correctors")),
        ("r.mat", ("--matrix", "R.response", "--bpm-names", "R.bpms", "--corrector-names",
                   "R.correctors")),
    ],
)  # fmt: skip
def test_there_and_back(learned, name, options, tmp_path):
    run("export", "response", "-o", name)
    run("import", "response", name, *options, "-o", "back.safetensors")
    back = read_response(tmp_path / "back.safetensors", CHANNELS)
    assert np.array_equal(back.table.response, learned[1])
    run("export", "response", "back.safetensors", "-o", "again.csv")
    run("export", "response", "-o", "first.csv")
    assert (tmp_path / "again.csv").read_text() == (tmp_path / "first.csv").read_text()


def test_what_cannot_be_exported(learned, tmp_path):
    for arguments, error, words in (
        (("-o", "r.xlsx"), ExchangeError, ".csv"),
        (("no-such", "-o", "r.csv"), StoreError, "no-such"),
        (("-o", "absent/r.csv"), ExchangeError, "absent/r.csv"),
        (("--data", "elsewhere", "-o", "r.csv"), ExchangeError, "no active policy"),
    ):
        with pytest.raises(error, match=words):
            app(["export", "response", *arguments], standalone_mode=False)
    assert not list(tmp_path.glob("r.*")) and not list(tmp_path.glob(".unfinished*"))


def tick(number):
    rng = np.random.default_rng(number)
    read = number != 3
    orbit = Orbit(rng.standard_normal(3), np.array([True, number != 2, True]), 1e9 + number / 10)
    return TickRecord(
        tick=number,
        state=LoopState.CLOSED if number < 4 else LoopState.HELD,
        reason="",
        reading=Reading(orbit, rng.standard_normal(2), {"current": 0.4}, 0.0) if read else None,
        reference=np.arange(3.0),
        setpoints=rng.standard_normal(2),
        requested=np.zeros(2),
        dither=np.zeros(2),
        applied=rng.standard_normal(2),
        scale=1.0,
        written=float("nan"),
        policy_id="svd-µ",
        phases=Phases(0.0, 0.0, 0.0, 0.0, 0.0),
        latency=1e-3,
        missed=number,
    )


@pytest.fixture
def archive(tmp_path):
    """Two segments, as two runs wrote them, five ticks each."""
    for begin in (0, 5):
        clock = ManualClock()
        clock.advance(100.0 * begin)
        recorder = Recorder(tmp_path / "a", SMALL, ArchiveSettings(segment_megabytes=1), clock)
        recorder.write(deque(tick(number) for number in range(begin, begin + 5)))
        recorder.close()
    return tmp_path / "a"


def test_the_archive_as_parquet(archive, tmp_path):
    answer = export_archive(archive, tmp_path / "a.parquet")
    assert answer["rows"] == 10 and answer["segments"] == 2
    table = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    wanted = [tick(number) for number in range(10)]
    assert table["tick"].to_pylist() == list(range(10))
    assert table["state"].to_pylist() == [str(each.state) for each in wanted]
    assert table["policy_id"].to_pylist() == ["svd-µ"] * 10
    assert len(set(table["run"].to_pylist())) == 2
    for name in ("setpoints", "applied", "reference"):
        expected = np.array([getattr(each, name) for each in wanted])
        assert np.array_equal(np.array(table[name].to_pylist()), expected), name
    valid = np.array(table["valid"].to_pylist())
    assert not valid[3].any() and valid[2].tolist() == [True, False, True]
    assert np.isnan(table["orbit"].to_pylist()[3]).all()
    np.testing.assert_array_equal(table["orbit"].to_pylist()[4], wanted[4].reading.orbit.position)
    assert table["auxiliary/current"].to_pylist()[0] == 0.4
    about = table.schema.field("orbit").metadata
    assert json.loads(about[b"names"]) == ["B1:x", "B2:x", "B3:x"] and about[b"unit"] == b"m"


def test_a_corrupt_segment_is_told_or_skipped(archive, tmp_path):
    bad = sorted(archive.glob("*.h5"))[0]
    bad.write_bytes(bad.read_bytes()[:1000])
    with pytest.raises(ArchiveError):
        export_archive(archive, tmp_path / "a.parquet")
    assert not (tmp_path / "a.parquet").exists()
    assert not list(tmp_path.glob(".unfinished*"))
    answer = export_archive(archive, tmp_path / "a.parquet", skip_corrupt=True)
    assert answer["rows"] == 5 and answer["skipped"] == bad.name


def test_parquet_that_cannot_be_written(archive, tmp_path):
    for out, words in ((tmp_path / "a.csv", ".parquet"), (tmp_path / "no/a.parquet", "cannot")):
        with pytest.raises(ExchangeError, match=words):
            export_archive(archive, out)
    with pytest.raises(ArchiveError, match="no archive"):
        export_archive(tmp_path / "absent", tmp_path / "a.parquet")


@contextlib.contextmanager
def room_for(size):
    """No file may grow beyond a size, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("size", [0, 700])
def test_the_archive_does_not_half_fit_on_a_full_disk(archive, tmp_path, size):
    out = tmp_path / "out"
    out.mkdir()
    (out / "a.parquet").write_text("before")
    with room_for(size), pytest.raises(ExchangeError, match="make room or name another place"):
        export_archive(archive, out / "a.parquet")
    assert [path.name for path in out.iterdir()] == ["a.parquet"]
    assert (out / "a.parquet").read_text() == "before"
    assert export_archive(archive, out / "a.parquet")["rows"] == 10
    assert pyarrow.parquet.read_table(out / "a.parquet").num_rows == 10


@pytest.mark.parametrize("suffix", ["csv", "h5", "mat"])
def test_a_response_does_not_half_fit_on_a_full_disk(learned, tmp_path, suffix):
    """HDF5 never meets it: the file is made in memory."""
    out = tmp_path / "out"
    out.mkdir()
    (out / f"r.{suffix}").write_text("before")
    command = ["export", "response", "--out", str(out / f"r.{suffix}")]
    with room_for(20_000):
        refused = CliRunner().invoke(app, command)
    assert isinstance(refused.exception, ExchangeError)
    assert "make room or name another place" in str(refused.exception)
    assert [path.name for path in out.iterdir()] == [f"r.{suffix}"]
    assert (out / f"r.{suffix}").read_text() == "before"
    assert CliRunner().invoke(app, command).exit_code == 0
    assert (out / f"r.{suffix}").stat().st_size > 20_000

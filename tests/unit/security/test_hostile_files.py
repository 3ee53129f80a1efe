"""Files made to harm: each is refused by a known error, soon, and without much memory."""

import io
import json
import struct
import time
import tracemalloc
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
import pytest

from orbitfb.app.commands import autosave
from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError, OrbitFeedbackError, RecordError
from orbitfb.core.files.bounded import LARGEST_TEXT, read_bytes
from orbitfb.diagnose.result.diagnosis import read_diagnosis
from orbitfb.effects.files import read_effects
from orbitfb.evaluate.pool.shelf import Shelf
from orbitfb.evaluate.pool.task import Task
from orbitfb.history.reader import read_archive
from orbitfb.loop.excitation.file import read_excitation
from orbitfb.measure.response_file import read_response
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.panel.access import read_access
from orbitfb.physics.places import Ring
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.postmortem.reading import read_postmortem
from orbitfb.records.reading.hdf5 import read_hdf5
from orbitfb.records.reading.npz import read_npz

DEEP = 20_000
MOST_MEMORY = 120 * 2**20
MOST_TIME = 10.0
RING = Ring.load()
CHANNELS = RING.channels("x")


@contextmanager
def refused(*errors: type[Exception]) -> Iterator[None]:
    """See that it is refused with a message, without much memory and time."""
    tracemalloc.start()
    begin = time.monotonic()
    try:
        with pytest.raises(errors or OrbitFeedbackError) as caught:
            yield
        taken, (_, peak) = time.monotonic() - begin, tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(str(caught.value)) < 2000
    assert peak < MOST_MEMORY, f"{peak >> 20} MiB"
    assert taken < MOST_TIME


def npz(path: Path, **members: bytes) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return path


def header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    """The head of an .npy file that claims a shape."""
    text = repr({"descr": kind, "fortran_order": False, "shape": shape}).encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def pickled() -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    return stream.getvalue()


def excite(path: Path) -> object:
    return read_excitation(path, CHANNELS, np.eye(180), 0.1)


def rules(path: Path) -> object:
    return read_access(path, "127.0.0.1", ("Command-Cmd",))


TOML_READERS: list[Callable[[Path], object]] = [load_config, read_effects, excite, rules]
HOSTILE_TOML = {
    "deep": b"a = " + b"[" * DEEP + b"]" * DEEP,
    "deep tables": b"[" + b"a." * DEEP + b"a]\n",
    "digits": b"a = " + b"9" * 100_000,
    "no text": bytes(range(128, 256)) * 100,
    "long": b"# " + b"x" * (LARGEST_TEXT + 1),
}


@pytest.mark.parametrize("what", HOSTILE_TOML)
@pytest.mark.parametrize("reader", TOML_READERS, ids=["config", "effects", "excite", "rules"])
def test_toml(reader: Callable[[Path], object], what: str, tmp_path: Path):
    path = tmp_path / "file.toml"
    path.write_bytes(HOSTILE_TOML[what])
    with refused(ConfigError):
        reader(path)


def test_a_file_without_end():
    with refused(ConfigError):
        load_config(Path("/dev/zero"))
    with refused(RecordError):
        read_bytes(Path("/dev/zero"), 10_000_000, RecordError, "name another")


def test_a_hostile_variable_is_text(monkeypatch: pytest.MonkeyPatch):
    with refused(ConfigError):
        load_config(None, environment={"ORBITFB_SEED": "[" * 50_000})
    with refused(ConfigError):
        load_config(None, environment={"ORBITFB_SEED": "9" * 50_000})


HOSTILE_JSON = {
    "deep": b"[" * DEEP + b"]" * DEEP,
    "deep objects": b'{"a":' * DEEP + b"1" + b"}" * DEEP,
    "digits": b'{"nu_x": ' + b"9" * 100_000 + b"}",
    "NaN": b'{"nu_x": NaN}',
    "cut": b'{"nu_x": 1',
    "text": b'"orbitfb"',
}


JSON_READERS: dict[str, Callable[[Path], object]] = {
    "ring": lambda path: Ring.load(None, path),
    "diagnosis": read_diagnosis,
    "autosave": lambda path: autosave.read_whole(path, autosave.Saved, "remove it"),
    "store": lambda path: PolicyStore(path.parent).load("svd-1", CHANNELS),
    "checkpoint": lambda path: Checkpoint(path.parent, {})._card(),
}


@pytest.mark.parametrize("what", HOSTILE_JSON)
@pytest.mark.parametrize("reader", JSON_READERS)
def test_json(reader: str, what: str, tmp_path: Path):
    content = HOSTILE_JSON[what]
    (tmp_path / "svd-1").mkdir()
    for name in ("file.json", "card.json", "svd-1/card.json", "svd-1/policy.json"):
        (tmp_path / name).write_bytes(content)
    with refused():
        JSON_READERS[reader](tmp_path / "file.json")


def test_a_shelf_runs_again_what_is_damaged(tmp_path: Path):
    shelf, task = Shelf(tmp_path), Task("orbitfb.evaluate.pool.task:encode", {})
    for content in HOSTILE_JSON.values():
        (tmp_path / f"{task.key}.json").write_bytes(content)
        assert shelf.find(task) is None


def test_a_table_with_an_endless_cell(tmp_path: Path):
    path = tmp_path / "places.csv"
    path.write_text("name,kind\n" + "x" * 200_000 + ",BPM\n")
    with refused():
        Ring.load(path)


HOSTILE_NPZ: dict[str, dict[str, bytes]] = {
    "shape without data": {"waveform": header((10**12, 10**3))},
    "negative shape": {"waveform": header((-(10**9), 4)) + bytes(64)},
    "overflowing shape": {"waveform": header((2**33, 2**33)) + bytes(64)},
    "a bomb": {"waveform": header((9_000_000,)) + bytes(72_000_000)},
    "objects": {"waveform": pickled()},
    "a header of code": {
        "waveform": b"\x93NUMPY\x01\x00" + struct.pack("<H", 30) + b"__import__('os')" + b" " * 14
    },
    "a deep header": {
        "waveform": b"\x93NUMPY\x02\x00" + struct.pack("<I", 3000) + b"(" * 3000,
    },
    "no array": {"waveform": b"\0" * 100},
}


@pytest.mark.filterwarnings("ignore::SyntaxWarning")
@pytest.mark.parametrize("what", HOSTILE_NPZ)
@pytest.mark.parametrize("reader", ["record", "excite"])
def test_npz(reader: str, what: str, tmp_path: Path):
    more = {"orbit": HOSTILE_NPZ[what]["waveform"]} if reader == "record" else {}
    path = npz(tmp_path / "file.npz", **HOSTILE_NPZ[what], **more)
    with refused():
        read_npz(path, 2**31) if reader == "record" else excite(path)


def test_excitation_with_texts_where_numbers_belong(tmp_path: Path):
    path = tmp_path / "file.npz"
    names = np.array(CHANNELS.correctors[:2])
    for start in (np.array("soon"), np.array([1.0, 2.0]), np.array(np.nan)):
        np.savez(path, waveform=np.zeros((3, 2)), corr_names=names, start_s=start)
        with refused(ConfigError):
            excite(path)


def claim(path: Path, name: str, kind: str = "f8") -> Path:
    """An HDF5 file of some kilobytes with an array of a terabyte."""
    with h5py.File(path, "w") as file:
        file.create_dataset(name, (10**9, 128), kind, chunks=(1024, 128), compression="gzip")
        file.attrs["schema_version"] = 1
    assert path.stat().st_size < 20_000
    return path


def test_hdf5_that_claims_a_terabyte(tmp_path: Path):
    with refused():
        read_hdf5(claim(tmp_path / "record.h5", "orbit"), 2**31)
    with refused():
        read_archive(claim(tmp_path / "segment.h5", "committed", "u1"))
    with refused():
        read_postmortem(claim(tmp_path / "postmortem.h5", "since_trip"))


def test_hdf5_that_points_elsewhere(tmp_path: Path):
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["orbit"] = np.zeros((4, 4))
    for link in (h5py.ExternalLink(str(secret), "/orbit"), h5py.SoftLink("/elsewhere")):
        path = tmp_path / "record.h5"
        with h5py.File(path, "w") as file:
            file["orbit"] = link
        with refused(RecordError):
            read_hdf5(path, 2**31)


HOSTILE_SAFETENSORS = {
    "a header of exabytes": struct.pack("<Q", 2**62) + b"{}",
    "a deep header": struct.pack("<Q", 100_000) + b"[" * 100_000,
    "offsets beyond the end": struct.pack("<Q", 64)
    + json.dumps({"r": {"dtype": "F64", "shape": [10**9], "data_offsets": [0, 8]}})
    .encode()
    .ljust(64),
    "empty": b"",
}


@pytest.mark.parametrize("what", HOSTILE_SAFETENSORS)
def test_safetensors(what: str, tmp_path: Path):
    path = tmp_path / "response.safetensors"
    path.write_bytes(HOSTILE_SAFETENSORS[what])
    with refused():
        read_response(path, CHANNELS)

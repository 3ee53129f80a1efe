"""A file that somebody else made is refused with the array and the row; none is believed."""

import h5py
import numpy as np
import pytest

from orbitfb.core.errors import RecordError
from orbitfb.postmortem.opening import read_about
from orbitfb.postmortem.reading import read_postmortem


def replace(file, name, values):
    del file[name]
    file[name] = values


def put(file, name, row, value):
    file[name][row] = value


HOSTILE = {
    "a state that is none": (lambda f: put(f, "state", 17, 200), "'state', row 17"),
    "a reason that is none": (lambda f: put(f, "reason", 3, -1), "'reason', row 3"),
    "time backwards": (lambda f: put(f, "since_trip", 9, -99.0), "'since_trip', row 9"),
    "time that is none": (lambda f: put(f, "since_trip", 5, np.nan), "'since_trip', row 5"),
    "a reference that is none": (
        lambda f: put(f, "reference", (2, 0), np.nan),
        "'reference', row 2",
    ),
    "an array that is missing": (lambda f: f.pop("applied"), "'applied' is missing"),
    "an array of another shape": (
        lambda f: replace(f, "orbit", np.zeros((41, 7))),
        r"'orbit' has shape \(41, 7\)",
    ),
    "an array of text": (lambda f: replace(f, "scale", np.array([b"x"] * 41)), "'scale' has shape"),
    "a link to another file": (
        lambda f: (f.pop("orbit"), f.__setitem__("orbit", h5py.ExternalLink("/etc/x.h5", "/x"))),
        "'orbit' is missing",
    ),
    "data in another file": (
        lambda f: (
            f.pop("tick"),
            f.create_dataset("tick", (41,), "<i8", external=[("/etc/passwd", 0, 328)]),
        ),
        "'tick' lies in another file",
    ),
    "names without end": (
        lambda f: replace(f, "channels/bpms", np.zeros(200_000, "S4")),
        "'channels/bpms' has shape",
    ),
    "too many rows": (
        lambda f: (
            f.pop("since_trip"),
            f.create_dataset("since_trip", (10**9,), "<f8", chunks=(1024,)),
        ),
        "'since_trip' has shape",
    ),
    "an object array": (
        lambda f: replace(f, "reasons", np.array(["x"], dtype=h5py.string_dtype())),
        "'reasons' has shape",
    ),
    "no JSON": (lambda f: replace(f, "about", np.bytes_(b"[" * 9000)), "'about' is no JSON object"),
    "no planes": (lambda f: replace(f, "about", np.bytes_(b"{}")), "'about' has planes ''"),
    "planes of no size": (
        lambda f: replace(f, "about", np.bytes_(b'{"planes": "xy", "bpm_counts": [1, 1]}')),
        r"'about' has bpm_counts \[1, 1\] for 6 devices in planes 'xy'",
    ),
    "sizes that are no counts": (
        lambda f: replace(f, "about", np.bytes_(b'{"planes": "x", "corrector_counts": "4"}')),
        "'about' has corrector_counts '4', which are no counts",
    ),
    "another version": (lambda f: f.attrs.__setitem__("schema_version", 9), "schema_version 1"),
    "a version that is a text": (
        lambda f: f.attrs.__setitem__("schema_version", "9" * 1000),
        "schema_version 1",
    ),
    "fewer events than times": (
        lambda f: replace(f, "events/since_trip", np.zeros(3)),
        "'events/level' has 0 rows",
    ),
    "huge chunks": (
        lambda f: (
            f.pop("scale"),
            f.create_dataset("scale", (41,), "<f8", maxshape=(None,), chunks=(2**27,)),
        ),
        "'scale' has chunks",
    ),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_with_the_array(tripped, name):
    _, path = tripped
    damage, message = HOSTILE[name]
    with h5py.File(path, "a") as file:
        damage(file)
    with pytest.raises(RecordError, match=message) as caught:
        read_postmortem(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("cut", [0, 10, 700, 5000, 20_000])
def test_a_truncated_file_is_refused(tripped, cut):
    _, path = tripped
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(RecordError, match="is damaged, or no post-mortem"):
        read_postmortem(path)


def test_flipped_bytes_never_end_in_anything_but_an_error_or_a_file(tripped):
    _, path = tripped
    whole = path.read_bytes()
    random = np.random.default_rng(1)
    for _ in range(60):
        broken = bytearray(whole)
        for place in random.integers(0, len(whole), 30):
            broken[place] = int(random.integers(256))
        path.write_bytes(broken)
        try:
            read_postmortem(path)
        except RecordError:
            continue


def test_what_is_no_file_is_said(tmp_path):
    with pytest.raises(RecordError, match="there is no file"):
        read_postmortem(tmp_path)
    text = tmp_path / "x.h5"
    text.write_text("not this")
    with pytest.raises(RecordError, match="is damaged, or no post-mortem"):
        read_about(text)


def test_no_more_is_read_than_allowed(tripped):
    _, path = tripped
    with pytest.raises(RecordError, match="are left of what is allowed"):
        read_postmortem(path, largest=10_000)

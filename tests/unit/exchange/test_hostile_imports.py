"""Damaged and hostile files: one sentence, nothing unpacked, nothing written."""

import contextlib

import h5py
import numpy as np
import pytest
import scipy.io

from orbitfb.core.errors import ExchangeError
from orbitfb.exchange.formats.datasets import matrix_of
from orbitfb.exchange.formats.mat5_file import Mat5Source
from orbitfb.exchange.formats.source import names_from, open_source


def refused(path, where="R"):
    with pytest.raises(ExchangeError) as caught:
        matrix_of(open_source(path).get(where), path)
    return str(caught.value)


def test_what_cannot_be_opened(tmp_path):
    assert "cannot be read" in refused(tmp_path / "absent.h5")
    assert "no plain file" in refused(tmp_path)
    (tmp_path / "empty.mat").touch()
    assert "0 bytes" in refused(tmp_path / "empty.mat")
    (tmp_path / "a.pkl").write_bytes(b"\x80\x04.")
    assert "'.pkl'" in refused(tmp_path / "a.pkl")


@pytest.mark.parametrize("name", ["a.mat", "a.h5", "a.csv"])
def test_noise_is_no_file(tmp_path, name):
    (tmp_path / name).write_bytes(np.random.default_rng(3).bytes(5000))
    assert name in refused(tmp_path / name)


def test_every_truncation_of_a_mat_file_is_refused(tmp_path):
    whole, cut = tmp_path / "whole.mat", tmp_path / "cut.mat"
    scipy.io.savemat(whole, {"R": np.random.default_rng(1).random((9, 9))}, do_compression=True)
    content = whole.read_bytes()
    for length in range(1, len(content) - 1, 13):
        cut.write_bytes(content[:length])
        assert "cut.mat" in refused(cut)


def test_a_mat_file_with_flipped_bytes_raises_nothing_else(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"S": {"R": np.ones((5, 5)), "n": ["a", "b"]}})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    rng, bad = np.random.default_rng(5), tmp_path / "b.mat"
    for _ in range(60):
        spoilt = content.copy()
        spoilt[rng.integers(124, len(content))] = rng.integers(256)
        bad.write_bytes(spoilt)
        with contextlib.suppress(ExchangeError):
            matrix_of(open_source(bad).get("S.R"), bad)


def test_a_bomb_is_counted_and_not_unpacked(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"R": np.zeros((1200, 1200))}, do_compression=True)
    assert (tmp_path / "a.mat").stat().st_size < 200_000
    with pytest.raises(ExchangeError, match="unpacks to more than the 1000000 bytes"):
        Mat5Source(tmp_path / "a.mat", largest=1_000_000)


def test_an_array_of_hdf5_that_only_claims_its_size(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("R", shape=(200_000, 200_000), dtype="f8", chunks=(100, 100))
    assert "bytes, " in refused(tmp_path / "a.h5")


def test_links_and_arrays_in_other_files(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["R"] = np.ones((3, 3))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["R"] = h5py.ExternalLink("other.h5", "R")
        file["soft"] = h5py.SoftLink("/nowhere")
        file.create_dataset("raw", (3,), "f8", external=[("other.bin", 0, 24)])
    assert "link" in refused(tmp_path / "a.h5")
    assert "soft" in refused(tmp_path / "a.h5", "soft")
    assert "another file" in refused(tmp_path / "a.h5", "raw")


def test_objects_are_not_opened(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"R": np.array([1 + 2j, 3]), "t": "text"})
    assert "real numbers" in refused(tmp_path / "a.mat")
    assert "names" in refused(tmp_path / "a.mat", "t")
    assert "there is no 'Q'" in refused(tmp_path / "a.mat", "Q")
    assert "no path" in refused(tmp_path / "a.mat", "R((")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,2\n3\n", "line 2"),
        ("1,2\n3,x\n", "column 2"),
        ("1;2\n3,5;4\n", "column 1"),
        ("a,b\n", "without numbers"),
        ('1,"2\n', "no table"),
    ],
)
def test_a_table_with_a_hole(tmp_path, text, words):
    (tmp_path / "a.csv").write_text(text)
    assert words in refused(tmp_path / "a.csv", "values")


def test_lists_of_names_are_bounded(tmp_path):
    np.savetxt(tmp_path / "a.csv", np.eye(2), delimiter=",")
    (tmp_path / "n.txt").write_text("x" * 300)
    with pytest.raises(ExchangeError, match="at most"):
        names_from(open_source(tmp_path / "a.csv"), f"@{tmp_path / 'n.txt'}")

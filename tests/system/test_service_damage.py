"""Damaged or foreign policies and archives are refused by name, and what is there stays."""

import json
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_process import Ioc, orbitfb, refused

pytestmark = pytest.mark.system

RUN = ("run", "--metrics-port", 0, "--duration", 1)
SIM = (*RUN, "--ioc", "sim", "--port", 0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The data directory of a short run that is over."""
    data = tmp_path_factory.mktemp("recorded") / "data"
    options = ("--port", 0, "--metrics-port", 0, "--duration", 3)
    done = orbitfb("run", "--ioc", "sim", "--data", data, *options)
    assert done.returncode == 0
    return data


@pytest.fixture
def data(recorded: Path, tmp_path: Path) -> Path:
    """A copy of it to be damaged."""
    subprocess.run(["cp", "-r", recorded, tmp_path / "data"], check=True)
    return tmp_path / "data"


def only_policy(data: Path) -> Path:
    [policy] = [path for path in (data / "policies").iterdir() if path.is_dir()]
    return policy


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ioc]:
    """A ring that nobody has yet."""
    with Ioc(tmp_path_factory.mktemp("other")) as ioc:
        yield ioc


@pytest.mark.parametrize(
    "damage",
    [
        "flipped",
        "gone",
        *(pytest.param(each, marks=pytest.mark.nightly) for each in ("longer", "card")),
    ],
)
def test_damaged_policy(damage: str, data: Path, other: Ioc):
    policy = only_policy(data)
    tensors = policy / "policy.safetensors"
    content = bytearray(tensors.read_bytes())
    if damage == "flipped":
        content[len(content) // 2] ^= 1
        tensors.write_bytes(content)
    elif damage == "longer":
        tensors.write_bytes(content + b"x")
    elif damage == "card":
        (policy / "card.json").write_text("{")
    else:
        tensors.unlink()
    # A ring of its own is new and gets the baseline; one that goes on needs what was in force.
    start = (*RUN, "--ioc", f"127.0.0.1:{other.port}")
    for arguments in (("policies", "activate", policy.name), start):
        said = refused(*arguments, "--data", data)
        assert said.startswith(str(policy)), said
        assert re.search(r"remove|refit|activate another", said)
    assert json.loads((data / "policies/active.json").read_text())["activations"]


def test_damaged_list_of_activations(data: Path):
    (data / "policies/active.json").write_text('{"schema_version": 1, "activations": [')
    for arguments in (("policies", "list"), ("policies", "rollback"), SIM):
        said = refused(*arguments, "--data", data)
        assert said.startswith(f"{data}/policies/active.json is not readable JSON (")
        assert said.endswith(f"remove {data}/policies/active.json and activate a policy by name")


@pytest.mark.parametrize("damage", ["random bytes", "no segment", "empty", "nothing there"])
def test_corrupt_archive(damage: str, data: Path):
    archive = data / "archive"
    segment = sorted(archive.glob("*.h5"))[0]
    if damage == "random bytes":
        content = bytearray(segment.read_bytes())
        content[2000:200_000] = bytes(range(256)) * 773 + bytes(112)
        segment.write_bytes(content)
    elif damage == "no segment":
        segment.write_text("not an HDF5 file")
    elif damage == "empty":
        segment.unlink()
    else:
        archive = data / "nowhere"
    said = refused("refit", "--from", archive, "--data", data, "--activate")
    assert str(archive if damage in ("empty", "nothing there") else segment) in said
    assert "; " in said
    assert only_policy(data)  # nothing new was stored


def test_archive_of_another_ring(data: Path):
    said = refused("refit", "--from", data / "archive", "--data", data, "--planes", "y")
    assert "is of another ring: its planes differ (x instead of y); name an archive of" in said


@pytest.mark.nightly
def test_policy_of_another_ring(data: Path, tmp_path: Path):
    with Ioc(tmp_path, 0, ("--planes", "y")) as ioc:
        options = ("--planes", "y", "--data", data)
        said = refused(*RUN, "--ioc", f"127.0.0.1:{ioc.port}", *options)
    assert said.startswith(str(only_policy(data)))
    assert "ring" in said or "planes" in said

"""What is trained beside a running service: stored whatever happens, in force only if it may."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from service_process import Service, orbitfb, refused

pytestmark = pytest.mark.system


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A closed loop in x whose first policy is trained, briefly."""
    directory = tmp_path_factory.mktemp("activation")
    config = directory / "orbitfb.toml"
    lessons = "[policy.supervised]\niterations = 40\nbatch = 8\n"
    # What learnt so little lets the orbit grow; slowly, and it is to stay closed meanwhile.
    patient = "[interlocks]\ndivergence_ticks = 100000\nprediction_ticks = 0\n"
    quick = "[learn]\nenabled = false\n[train.supervised]\nbatch = 4\n"
    config.write_text(quick + lessons + patient)
    options = ("--rate", 10.0, "--policy", "supervised", "--config", config)
    with Service(directory / "data", "sim", *options) as running:
        running.wait_status("closed", lambda status: status["state"] == "CLOSED", 30.0)
        yield running


def stored(said: str) -> str:
    [name] = re.findall(r"^policy (\S+) is stored in \S+, but was not activated: ", said)
    return name


def test_a_first_training_is_not_silent(service: Service):
    told = [event["progress"] for event in service.events("starting")]
    assert told[0] == "training the first policy (supervised): 40 iterations"
    assert told[1].startswith("training the first policy (supervised): 1 of 40 iterations, loss ")
    assert told[-2].startswith("training the first policy (supervised): 40 of 40 iterations")
    assert re.fullmatch(r"training the first policy \(supervised\) took \d+ s", told[-1])
    assert len(told) == 13
    assert told[0] in service.out


def test_a_policy_of_another_plane_is_stored_and_named(service: Service):
    before = service.status()["policy"]
    said = refused("train", "svd", "--planes", "y", "--activate", "--data", service.data)
    name = stored(said)
    assert "is a policy for planes 'y', the ring runs 'x'" in said
    assert (service.data / "policies" / name / "card.json").is_file()
    assert service.status()["policy"] == before


def test_what_would_run_away_needs_force(service: Service):
    before = service.status()["policy"]
    wild = ("supervised", "--published", "--iterations", 3, "--device", "cpu")
    config = Path(service.data).parent / "orbitfb.toml"
    common = ("--data", service.data, "--config", config)
    said = refused("train", *wild, "--activate", *common)
    name = stored(said)
    assert ": unstable: " in said
    assert f"`orbitfb policies activate {name} --force`" in said
    assert service.status()["policy"] == before
    listed = orbitfb("policies", "list", "--data", service.data).stdout
    assert re.search(rf"^  {name} +network +x .*\n    unstable: ", listed, re.MULTILINE)
    done = orbitfb("policies", "activate", name, "--force", "--data", service.data)
    assert done.returncode == 0, done.stderr
    assert re.search(rf"^policy +{name}$", done.stdout, re.MULTILINE)
    assert re.search(r"^warning +unstable: ", done.stdout, re.MULTILINE)
    service.wait_status("swap", lambda status: status["policy"] == name, 2.0)

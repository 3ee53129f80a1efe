"""`orbitfb train forward` from two archives to a policy that is trained on the net."""

import json
from pathlib import Path

import numpy as np
import pytest

from orbitfb.cli.app import app
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import EstimationError, StoreError
from orbitfb.core.ports import Subscriber
from orbitfb.core.signals import LoopState
from orbitfb.history.archive import ArchiveSettings, ArchiveWriter
from orbitfb.loop.excitation.dither import Dither, DitherSettings
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

CONFIG = """
[train.forward]
hidden = [8]
members = 2
window = 64
[train.trajectory]
batch = 2
horizon = 2
"""


SETTLING = 100
"""Ticks in which the orbit comes from 250 µm to the noise floor."""


def operate(directory: Path, ticks: int, seed: int, wall: float, dither: float = 0.0) -> Path:
    """Record the loop on the simulated ring, once it is closed and its ramp is over."""
    clock = ManualClock(wall)
    machine = PlantMachine(Plant(Ring.load(), "x", seed=seed), clock)
    response = machine.plant.nominal_response
    subscribers: list[Subscriber] = []
    archive = ArchiveWriter(directory, machine.channels, ArchiveSettings(queue=ticks))
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(response, SvdSettings())),
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(answer_reach=None),  # operation is quiet: nothing is asked of the ring
        np.zeros(len(machine.channels.bpms)),
        clock,
        Dither(DitherSettings(orbit_cost=dither), response, 0.5),
        LoopState.CLOSED,
        subscribers=(lambda record: [take(record) for take in subscribers],),
    )
    for tick in range(SETTLING + ticks):
        if tick == SETTLING:
            subscribers.append(archive)
        runner.step()
    archive.close()
    assert archive.status().dropped == 0
    return directory


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path, Path]:
    """Operation, the same with a dither, and more of the first kind."""
    base = tmp_path_factory.mktemp("operation")
    return (
        operate(base / "quiet", 760, 1, 1.7e9),
        operate(base / "dithered", 250, 2, 1.8e9, dither=2e-6),
        operate(base / "other", 150, 3, 1.9e9),
    )


@pytest.fixture
def train(tmp_path: Path):
    """The command, on a data directory of its own."""
    (tmp_path / "quick.toml").write_text(CONFIG)

    def run(*arguments: object) -> None:
        common = ("--config", tmp_path / "quick.toml", "--data", tmp_path, "--device", "cpu")
        app([str(word) for word in ("train", *arguments, *common)], standalone_mode=False)

    return run


def test_a_net_is_trained_validated_kept_and_trained_on_unless_it_failed(
    archives, train, tmp_path, capsys
):
    quiet, dithered, _ = archives
    train("forward", "--from", quiet, "--validate", dithered, "--iterations", 3, "--json")
    answer = json.loads(capsys.readouterr().out)
    kept = tmp_path / "models" / answer["stored"]
    assert answer["method"] == "forward" and answer["stored"].startswith("forward-")
    figures = json.loads((kept / "card.json").read_text())["figures"]
    assert figures == {name: answer[name] for name in figures}
    assert answer["trusted"] == 1.0
    assert answer["slope"] == pytest.approx(1.0, abs=0.1)
    assert not any((tmp_path / "training").iterdir())
    train("trajectory", "--model", answer["stored"], "--iterations", 2)
    assert "stored" in capsys.readouterr().out
    [policy] = (tmp_path / "policies").glob("network-*")
    card = json.loads((policy / "card.json").read_text())
    assert card["training"]["method"] == "trajectory"
    content = json.loads((kept / "card.json").read_text())
    content["figures"]["trusted"] = 0.0
    (kept / "card.json").write_text(json.dumps(content))
    with pytest.raises(EstimationError, match="failed its validation"):
        train("trajectory", "--model", answer["stored"], "--iterations", 2)
    with pytest.raises(StoreError, match="there is no model 'forward-0'"):
        train("trajectory", "--model", "forward-0", "--iterations", 2)


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (0, "are in .* too; data that were used for training prove"),
        pytest.param(2, "no other excitation", marks=pytest.mark.nightly),
    ],
)
def test_a_validation_that_proves_nothing_is_refused(archives, train, tmp_path, other, said):
    with pytest.raises(EstimationError, match=said):
        train("forward", "--from", archives[0], "--validate", archives[other], "--iterations", 3)
    assert not (tmp_path / "models").exists()

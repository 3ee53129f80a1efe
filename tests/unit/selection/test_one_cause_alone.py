"""One cause, and what a first search leaves of it is no second one."""

from pathlib import Path

import pytest

from benchmarks.blind.many import write
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.registry import all_effects
from orbitfb.records.reading.load import load


def found(machine: str, fault: str, seed: int, folder: Path) -> list[str]:
    name = write(machine, fault, seed, folder / "records")
    record = load(folder / "records" / f"{name}.npz", planes=None, ring=None).record
    kinds = [one for one in all_effects().values() if not one.unavailable(record)]
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    return [one.kind.id for one in accepted]


@pytest.mark.parametrize(("machine", "seed"), [("shaking", 10), ("few-correctors", 12)])
def test_a_corrector_that_is_stuck(machine: str, seed: int, tmp_path: Path) -> None:
    """A floor that knows of no shaking takes a wrong row for as good, and that leaves kicks."""
    assert found(machine, "stuck", seed, tmp_path) == ["corrector-stuck"]


def test_setpoints_that_act_late(tmp_path: Path) -> None:
    """Those before the record are not in it: its first row is off as if one place kicked."""
    assert found("dither", "delay", 11, tmp_path) == ["loop-delay"]


def test_a_corrector_that_trips(tmp_path: Path) -> None:
    """It loses its whole current at once, and not what it moved by since the first row."""
    for seed in (1, 2):
        assert found("plain", "trip", seed, tmp_path) == ["corrector-stuck"]


def test_bpms_that_jump_together(tmp_path: Path) -> None:
    """Each by an offset of its own: neither a current that they follow nor kicks of the beam."""
    for seed in (1, 2):
        assert found("plain", "crate", seed, tmp_path) == ["bpm-offset"]


def test_noise_that_bpms_have_in_common(tmp_path: Path) -> None:
    """It is new at every row, and what a walk along the same BPMs explains of it is no walk."""
    for seed in (1, 2):
        assert found("plain", "common-noise", seed, tmp_path) == ["noise-correlated"]

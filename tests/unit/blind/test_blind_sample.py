"""A small fixed sample of the blind check: records of every generator, diagnosed and right."""

from pathlib import Path

import pytest

from benchmarks.blind import engines, fodo, many, sources
from benchmarks.blind.judging import judge
from benchmarks.blind.records import Case, read_folder

SEED = 37
PLANT = Path(__file__).resolve().parents[4] / "shared" / "plant"
"""An independent generator, where there is one."""

SMALL = (
    ("shaking", "healthy"), ("strong-ground", "healthy"), ("coarse", "bpm-gain"),
    ("flicker", "crate"), ("few-correctors", "corrector-gain"), ("held", "bpm-gain"),
    ("invalid", "stuck"), ("more-bpms", "common-noise"),
)  # fmt: skip


def check(case: Case) -> None:
    """A healthy ring has no gap; an effect is named, and none without 0.9."""
    answer = engines.installed(case.record, ring=case.ring)
    found = judge(case.truth, answer, case=case.name)
    assert found.right, (case.name, found.state, found.names, found.probability)
    assert not found.named or found.probability >= 0.9


@pytest.mark.parametrize(("machine", "fault"), SMALL)
def test_small_rings_of_many_kinds(machine: str, fault: str, tmp_path: Path) -> None:
    name = many.write(machine, fault, SEED, tmp_path / "many")
    (case,) = read_folder(tmp_path / "many", chosen=[name])
    check(case)


@pytest.mark.parametrize("effect", list(fodo.EFFECTS)[::2])
def test_a_ring_with_places(effect: str, tmp_path: Path) -> None:
    folder = tmp_path / "fodo"
    name = fodo.make(effect, SEED, folder, tmp_path / "fodo_truth")
    (case,) = read_folder(folder, chosen=[name])
    check(case)


@pytest.mark.parametrize("seed", [5, 12])
def test_the_default_ring_of_the_own_generator(seed: int, tmp_path: Path) -> None:
    """Orbits that are missed, and a healthy ring."""
    (case,) = sources.own(tmp_path, "quick", seed, 1, 1)
    check(case)


@pytest.mark.parametrize("number", [1, 75])
def test_an_independent_simulator(number: int, tmp_path: Path) -> None:
    """Of a healthy ring, and of a dead BPM."""
    if not PLANT.is_dir():
        pytest.skip(f"there is no generator in {PLANT}")
    (case,) = sources.external(PLANT, tmp_path, 1009, [number], 1, None)
    check(case)

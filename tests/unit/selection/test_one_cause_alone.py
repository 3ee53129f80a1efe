"""One cause, and what a first search leaves of it is no second one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.blind.many import write
from orbitfb.core.signals import FINEST
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.screen.run import screen
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.diagnose.verdict.proved import proved
from orbitfb.effects.registry import all_effects
from orbitfb.records.reading.load import load


def found(machine: str, fault: str, seed: int, folder: Path) -> list[str]:
    name = write(machine, fault, seed, folder / "records")
    record = load(folder / "records" / f"{name}.npz", planes=None, ring=None).record
    record = proved(record, screen(record), frozenset()).record
    kinds = [one for one in all_effects().values() if not one.unavailable(record)]
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    return [one.kind.id for one in accepted]


nightly = pytest.mark.nightly
"""In CI the quickest record of each fault is diagnosed, at night all of them."""


@pytest.mark.parametrize(
    ("machine", "seed"),
    [
        ("few-correctors", 12),
        pytest.param("shaking", 10, marks=nightly),
        pytest.param("shaking", 26, marks=nightly),
        pytest.param("flicker", 26, marks=nightly),
    ],
)
def test_a_corrector_that_is_stuck(machine: str, seed: int, tmp_path: Path) -> None:
    """A floor that knows of no shaking takes a wrong row for as good, and that leaves kicks.

    One that has reached its limit does nearly the same: the floors of both have to be at their
    best.
    """
    assert found(machine, "stuck", seed, tmp_path) == ["corrector-stuck"]


@pytest.mark.parametrize("machine", ["few-correctors", pytest.param("dither", marks=nightly)])
def test_setpoints_that_act_late(machine: str, tmp_path: Path) -> None:
    """Those before the record are not in it: its first row is off as if one place kicked."""
    assert found(machine, "delay", 11, tmp_path) == ["loop-delay"]


@nightly
def test_a_corrector_that_trips(tmp_path: Path) -> None:
    """It loses its whole current at once, and not what it moved by since the first row."""
    assert found("plain", "trip", 1, tmp_path) == ["corrector-stuck"]


@nightly
@pytest.mark.parametrize(("machine", "seed"), [("few-correctors", 22), ("unlike-bpms", 31)])
def test_a_corrector_that_trips_and_throws_the_beam_about(
    machine: str, seed: int, tmp_path: Path
) -> None:
    """The row at which it begins is told again over the floor that a like law leaves.

    Where an odd course at its place leads by ten times, its own laws get floors of their own, too.
    """
    assert found(machine, "trip", seed, tmp_path) == ["corrector-stuck"]


@nightly
def test_corrector_gains_that_play_has_nothing_to_say_of(tmp_path: Path) -> None:
    """Its values cannot be told where nothing shows, which is no error."""
    assert found("few-correctors", "corrector-gain", 22, tmp_path) == ["corrector-gain"]


@nightly
@pytest.mark.parametrize("seed", [19, 28])
def test_a_corrector_that_trips_in_a_polled_record(seed: int, tmp_path: Path) -> None:
    """What follows any course follows readings that were drawn without the law, too."""
    assert found("held", "trip", seed, tmp_path) == ["corrector-stuck"]


@nightly
@pytest.mark.parametrize("seed", [19, 30])
def test_a_corrector_that_trips_where_readings_are_missing(seed: int, tmp_path: Path) -> None:
    """At the last row, and near the row of the trip: few, drawn with the law once it is known."""
    assert found("invalid", "trip", seed, tmp_path) == ["corrector-stuck"]


@nightly
def test_play_of_correctors_that_began_anywhere(tmp_path: Path) -> None:
    """States of two that act alike are told together, beside errors of what they have."""
    assert found("plain", "play", 19, tmp_path) == ["corrector-hysteresis"]


@nightly
def test_correctors_that_lag_in_a_ring_that_shakes(tmp_path: Path) -> None:
    """A cause that is as likely as motion that healthy rings have is none yet."""
    assert found("one-shaking", "lag", 19, tmp_path) == ["corrector-lag"]


@nightly
def test_a_healthy_ring_that_shakes_has_no_odd_bpms(tmp_path: Path) -> None:
    """What BPMs have in common is not the noise of each."""
    assert found("shaking", "frozen", 19, tmp_path) == []


def test_bpms_that_jump_together(tmp_path: Path) -> None:
    """Each by an offset of its own: neither a current that they follow nor kicks of the beam."""
    assert found("plain", "crate", 1, tmp_path) == ["bpm-offset"]


@pytest.mark.parametrize(
    ("machine", "seed"), [("plain", 3), pytest.param("invalid", 19, marks=nightly)]
)
def test_noise_that_bpms_have_in_common(machine: str, seed: int, tmp_path: Path) -> None:
    """It is new at every row, and what a walk along the same BPMs explains of it is no walk."""
    assert found(machine, "common-noise", seed, tmp_path) == ["noise-correlated"]


def test_a_beam_that_is_thrown_about_leaves_the_readings_some_noise(tmp_path: Path) -> None:
    """The walk takes all that no model explains; numbers overflowed where no noise was left."""
    name = write("plain", "healthy", 1, tmp_path / "records")
    record = load(tmp_path / "records" / f"{name}.npz", planes=None, ring=None).record
    kicks = np.zeros_like(record.setpoints)
    steps = np.random.default_rng(0).standard_normal((150, kicks.shape[1]))
    kicks[300:450] = 0.04 * np.cumsum(steps, axis=0)
    thrown = replace(record, readings=record.readings + kicks @ record.layout.response.T)
    space = Workspace.of(thrown, list(all_effects().values())[:3])
    assert space.noise.reading.min() >= FINEST**2

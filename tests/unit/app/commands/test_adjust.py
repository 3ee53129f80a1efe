"""Commands that adjust the loop, and what of it is there after a restart."""

import json
import time
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from orbitfb.app.commands.adjust import Adjuster
from orbitfb.app.commands.autosave import FILE
from orbitfb.app.commands.base import Base
from orbitfb.core.errors import ConfigError, ControlError
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.excitation.dither import Dither, DitherSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.recent import Recent
from orbitfb.policies.svd import SvdPolicy, SvdSettings

CHANNELS = Ring.load().channels("xy")
RESPONSE = response(Ring.load(), "xy")
N, M = RESPONSE.shape
ON = [True] * N
REFERENCE = (50e-6 * np.sin(np.arange(N))).tolist()


class FakeRunner:
    """Takes adjustments as the runner does between two ticks."""

    def __init__(self) -> None:
        self.adjustments = Adjustments.none(np.zeros(N), M)

    @property
    def reference(self) -> np.ndarray:
        return self.adjustments.reference

    def adjust(self, wanted: Adjustments) -> None:
        self.adjustments = wanted


class Bench:
    """An adjuster and what it adjusts, of a data directory."""

    def __init__(self, directory: Path) -> None:
        self.runner = FakeRunner()
        self.slot = PolicySlot(SvdPolicy(RESPONSE, SvdSettings()))
        self.dither = Dither(DitherSettings(orbit_cost=1e-6), RESPONSE)
        self.counting, self.movable = np.ones(N, dtype=bool), np.ones(M, dtype=bool)
        self.counting[5] = self.movable[6] = False
        base = Base(CHANNELS, self.counting, self.movable, PanelSettings(), directory, Ring.load())
        self.adjuster = Adjuster(
            base, cast(Any, self.runner), self.slot, self.dither, lambda: None, every=0.01
        )

    def __call__(self, command: str, **arguments: object) -> Any:
        return self.adjuster.handlers[command]({"command": command, **arguments})


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def off(size: int, *which: int) -> list[bool]:
    return [index not in which for index in range(size)]


def test_the_gain_is_of_one_plane(bench: Bench):
    bench("gain", plane="y", value=0.25)
    gain = bench.runner.adjustments.gain
    np.testing.assert_array_equal(gain, np.repeat([1.0, 0.25], M // 2))
    shown = bench.adjuster.shown()
    assert (shown["GainX-RB"], shown["GainY-RB"]) == (1.0, 0.25)


def test_a_disabled_corrector_does_not_move_and_the_others_do_its_work(bench: Bench):
    bench("enable-correctors", enabled=off(M, 3))
    acting = bench.slot.acting
    assert isinstance(acting, MaskedPolicy)
    np.testing.assert_array_equal(np.flatnonzero(~acting.movable), [3, 6])  # 6 by configuration
    error = RESPONSE @ np.ones(M) * 1e-3
    change, _ = acting.act(error, np.array(ON), acting.initial_state())
    assert not change[[3, 6]].any() and change[2] != 0
    # what is promoted later is dressed alike
    bench.slot.swap(SvdPolicy(RESPONSE, SvdSettings(gain=0.5)))
    assert isinstance(bench.slot.acting, MaskedPolicy)
    bench("enable-correctors", enabled=[True] * M)
    np.testing.assert_array_equal(np.flatnonzero(~cast(Any, bench.slot.acting).movable), [6])


def test_enabling_does_not_enable_what_is_masked_by_configuration(bench: Bench):
    bench("enable-bpms", enabled=ON)
    shown = bench.adjuster.shown()
    assert shown["BpmEnable-RB"] == [int(index != 5) for index in range(N)]
    assert shown["CorrectorEnable-RB"] == [int(index != 6) for index in range(M)]


def test_what_masked_bpms_call_for_is_worked_out_before_the_loop_needs_it(bench: Bench):
    policy: Any = bench.slot.current
    calls: list[int] = []
    infill = policy._infill
    matrix = infill._matrix
    infill._matrices = Recent(lambda valid: calls.append(int(valid.sum())) or matrix(valid))
    bench("enable-bpms", enabled=off(N, 1, 2))
    assert calls == [N - 3]
    policy.act(np.zeros(N), np.array(off(N, 1, 2, 5)), policy.initial_state())
    assert calls == [N - 3]  # it is there


def test_everything_is_there_after_a_restart_but_the_state(bench: Bench, tmp_path: Path):
    bench("gain", plane="x", value=0.5)
    bench("reference", values=REFERENCE)
    bench("reference-save", name="golden-1")
    bench("enable-bpms", enabled=off(N, 0, N - 1))
    bench("enable-correctors", enabled=off(M, 2))
    bench("dither", orbit_cost=2e-6)
    bench("average", orbits=5)
    bench("dead-band", plane="y", value=1e-6)
    again = Bench(tmp_path)
    assert again.adjuster.restore()
    for name in ("gain", "reference", "enabled"):
        one, other = (getattr(b.runner.adjustments, name) for b in (bench, again))
        np.testing.assert_array_equal(one, other, name)
    assert again.adjuster.shown() == bench.adjuster.shown()
    assert again.dither.orbit_cost == 2e-6
    adjusted = again.runner.adjustments
    assert (adjusted.average, adjusted.dead_band) == (5, (0.0, 1e-6))
    assert again.adjuster.shown()["DeadBandY-RB"] == pytest.approx(1.0)
    assert not cast(Any, again.slot.acting).movable[2]
    saved = json.loads((tmp_path / FILE).read_text())
    assert saved["disabled_bpms"] == [f"{CHANNELS.bpms[0]}:x", f"{CHANNELS.bpms[-1]}:y"]
    assert "CLOSED" not in (tmp_path / FILE).read_text() and "state" not in saved
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_nobody_who_adjusted_nothing_restores_anything(bench: Bench):
    assert not bench.adjuster.restore()


def test_references_are_saved_and_loaded(bench: Bench):
    bench("reference", values=REFERENCE)
    bench("reference-save", name="golden")
    bench("reference", values=[0.0] * N)
    assert bench.adjuster.shown()["ReferenceName-I"] == ""
    bench("reference-load", name="golden")
    np.testing.assert_array_equal(bench.runner.reference, REFERENCE)
    assert bench.adjuster.shown()["ReferenceName-I"] == "golden"
    with pytest.raises(ControlError, match="no reference 'silver' was saved; known: golden"):
        bench("reference-load", name="silver")


@pytest.mark.parametrize("name", ["../golden", "a/b", "", ".hidden", "x" * 61, 7, None, "a b"])
def test_a_name_that_leads_elsewhere_is_refused(bench: Bench, tmp_path: Path, name: object):
    for command in ("reference-save", "reference-load"):
        with pytest.raises(ControlError, match="is no name of a reference"):
            bench(command, name=name)
    assert not (tmp_path / "references").exists()


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("gain", {"plane": "z", "value": 0.5}),
        ("gain", {"plane": "x", "value": 1.01}),
        ("gain", {"plane": "x", "value": float("nan")}),
        ("gain", {"plane": "x", "value": True}),
        ("gain", {"plane": "x"}),
        ("average", {"orbits": 0}),
        ("average", {"orbits": 1001}),
        ("average", {"orbits": 2.5}),
        ("average", {}),
        ("dead-band", {"plane": "x", "value": -1e-6}),
        ("dead-band", {"plane": "x", "value": 21e-6}),
        ("dead-band", {"plane": "z", "value": 1e-6}),
        ("dead-band", {"value": 1e-6}),
        ("reference", {"values": REFERENCE[:-1]}),
        ("reference", {"values": [*REFERENCE[:-1], 1.1e-3]}),
        ("reference", {"values": [*REFERENCE[:-1], float("nan")]}),
        ("reference", {"values": [*REFERENCE[:-1], "0"]}),
        ("reference", {}),
        ("enable-bpms", {"enabled": [False] * N}),
        ("enable-bpms", {"enabled": [1] * N}),
        ("enable-correctors", {"enabled": [index == 6 for index in range(M)]}),  # masked anyway
        ("dither", {"orbit_cost": 21e-6}),
        ("dither", {"orbit_cost": "1"}),
    ],
)
def test_what_is_refused_changes_and_saves_nothing(
    bench: Bench, tmp_path: Path, command: str, arguments: dict[str, object]
):
    before, shown = bench.runner.adjustments, bench.adjuster.shown()
    with pytest.raises(ControlError):
        bench(command, **arguments)
    assert bench.runner.adjustments is before and bench.adjuster.shown() == shown
    assert not (tmp_path / FILE).exists()


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text[:-100],
        lambda text: text.replace('"planes": "xy"', '"planes": "x"'),
        lambda text: text.replace('"y": 1.0', '"y": 1.5'),
        lambda text: text.replace('"disabled_bpms": []', '"disabled_bpms": ["nobody:x"]'),
        lambda text: text.replace('"gain"', '"state": "CLOSED", "gain"'),
        lambda text: " " * (5 << 20) + text,
    ],
)
def test_a_damaged_file_is_not_taken_for_none(bench: Bench, tmp_path: Path, damage: Any):
    """A corrector that was disabled must not move because a file cannot be read."""
    bench("gain", plane="x", value=0.5)
    whole = (tmp_path / FILE).read_text()
    (tmp_path / FILE).write_text(damage(whole))
    assert (tmp_path / FILE).read_text() != whole
    with pytest.raises(ConfigError, match=f"{FILE}: .* remove it and set it again"):
        Bench(tmp_path).adjuster.restore()


def test_a_disk_that_is_full_is_said_and_the_command_is_in_force(bench: Bench, tmp_path: Path):
    (tmp_path / f".{FILE}.part").mkdir()  # where the file would be written
    answer = bench("gain", plane="x", value=0.5)
    assert "in force, but not saved" in answer["warning"]
    assert bench.adjuster.shown()["GainX-RB"] == 0.5
    assert bench.adjuster.unsaved
    bench.adjuster.close()


def test_what_was_set_while_the_disk_was_full_is_saved_as_soon_as_there_is_room(
    bench: Bench, tmp_path: Path
):
    (tmp_path / f".{FILE}.part").mkdir()
    disabled = [index != 3 for index in range(M)]
    bench("gain", plane="x", value=0.5)
    bench("enable-correctors", enabled=disabled)
    (tmp_path / f".{FILE}.part").rmdir()  # there is room; no further command comes
    patience = time.monotonic() + 10.0
    while bench.adjuster.unsaved and time.monotonic() < patience:
        time.sleep(0.01)
    assert not bench.adjuster.unsaved
    after = Bench(tmp_path)
    assert after.adjuster.restore()
    assert after.adjuster.shown()["GainX-RB"] == 0.5
    assert not after.adjuster.movable[3]
    bench.adjuster.close()

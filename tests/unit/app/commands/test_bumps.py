"""A closed bump as a change of the reference: whole, bounded, there after a restart."""

import json
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from test_adjust import CHANNELS, Bench, M, N, off

from orbitfb.app.commands.autosave import FILE
from orbitfb.app.commands.bumps import Bumps
from orbitfb.core.errors import ConfigError, ControlError
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.bump import closed_bump, find_source
from orbitfb.physics.places import Ring

RING = Ring.load()
PLACE = "PL1B_C30,PL1A_C01"
SOURCE = find_source(RING, PLACE)
NOTHING = np.zeros(N)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def reference(bench: Bench) -> Any:
    return bench.runner.adjustments.reference


def orbit(plane: str, position: float, angle: float) -> Any:
    whole = np.zeros(N)
    part = CHANNELS.bpm_parts[plane]
    movable = np.ones(M // 2, dtype=bool)
    movable[6] = plane == "y"  # the bench has this one masked
    bump = closed_bump(RING, cast(Any, plane), SOURCE, position, angle, movable)
    whole[part] = bump.orbit
    return whole


def test_it_is_added_to_the_reference_and_is_what_was_asked_for_last(bench: Bench):
    bench("reference", values=[1e-5] * N)
    answer = bench("bump", place=PLACE, plane="x", position=80e-6)
    np.testing.assert_allclose(reference(bench), 1e-5 + orbit("x", 80e-6, 0.0), atol=1e-15)
    assert answer["position_um"] == pytest.approx(80.0) and answer["angle_urad"] == 0.0
    bench("bump", plane="x", angle=-5e-6)  # the place named last, its position as it is
    np.testing.assert_allclose(reference(bench), 1e-5 + orbit("x", 80e-6, -5e-6), atol=1e-15)
    bench("bump", plane="x", position=20e-6)
    bench("bump", plane="y", position=10e-6)
    both = orbit("x", 20e-6, -5e-6) + orbit("y", 10e-6, 0.0)
    np.testing.assert_allclose(reference(bench), 1e-5 + both, atol=1e-15)
    shown = bench.adjuster.shown()
    assert (shown["BumpPositionX-RB"], shown["BumpAngleX-RB"]) == pytest.approx((20.0, -5.0))
    assert shown["BumpPositionY-RB"] == pytest.approx(10.0) and shown["BumpPlace-RB"] == PLACE
    assert shown["Bumps-I"] == f"{PLACE} x 20 um -5 urad; {PLACE} y 10 um 0 urad"
    bench("bump", plane="x", position=0.0, angle=0)
    bench("bump", plane="y", position=0.0)
    np.testing.assert_array_equal(reference(bench), 1e-5)
    assert bench.adjuster.shown()["Bumps-I"] == ""


def test_a_place_can_be_named_first(bench: Bench):
    with pytest.raises(ControlError, match="name the place of the bump first"):
        bench("bump", plane="x", position=1e-5)
    assert bench("bump", place="26.4") == {"place": "26.4"}
    bench("bump", plane="x", position=1e-5)
    assert np.abs(reference(bench)).max() > 1e-5


def test_it_is_there_after_a_restart_and_can_be_taken_away(bench: Bench, tmp_path: Path):
    bench("bump", place=PLACE, plane="y", position=30e-6, angle=2e-6)
    again = Bench(tmp_path)
    assert again.adjuster.restore()
    assert again.adjuster.shown()["Bumps-I"] == f"{PLACE} y 30 um 2 urad"
    again("bump", place=PLACE, plane="y", position=0, angle=0)
    np.testing.assert_allclose(reference(again), NOTHING, atol=1e-18)


def test_a_bump_of_another_ring_is_not_restored(bench: Bench, tmp_path: Path):
    bench("bump", place=PLACE, plane="y", position=30e-6)
    file = tmp_path / FILE
    saved = json.loads(file.read_text())
    saved["bumps"][0]["orbit"].pop()
    file.write_text(json.dumps(saved))
    with pytest.raises(ConfigError, match="is of another ring or other planes"):
        Bench(tmp_path).adjuster.restore()


def test_another_reference_is_without_bumps(bench: Bench):
    bench("reference-save", name="golden")
    bench("bump", place=PLACE, plane="x", position=30e-6)
    assert bench("reference-load", name="golden")["bumps_gone"] == 1
    assert not reference(bench).any() and bench.adjuster.shown()["Bumps-I"] == ""
    bench("bump", place=PLACE, plane="x", position=30e-6)
    assert bench("reference", values=[0.0] * N)["bumps_gone"] == 1


def test_correctors_that_are_disabled_have_no_part(bench: Bench):
    used = np.flatnonzero(closed_bump(RING, "x", SOURCE, 3e-5).kicks)
    bench("enable-correctors", enabled=off(M, int(used[0])))
    bench("bump", place=PLACE, plane="x", position=3e-5)
    bump = next(iter(bench.adjuster._bumps.in_force.values()))
    setpoints = np.array(bump.setpoints)
    assert setpoints[used[0]] == 0.0 and np.count_nonzero(setpoints) == 6


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"place": "PL1", "position": 1e-5, "plane": "x"}, "no source 'PL1'"),
        ({"place": True}, "name the place of the bump first"),
        ({"place": PLACE, "position": 1e-5}, "plane must be x or y, not None"),
        ({"place": PLACE, "plane": "s", "position": 1e-5}, "plane must be x or y, not 's'"),
        (
            {"place": PLACE, "plane": "x", "position": 6e-4},
            "position must be a number from",
        ),
        ({"place": PLACE, "plane": "x", "position": "much"}, "position must be a number"),
        ({"place": PLACE, "plane": "x", "angle": float("nan")}, "angle must be a number from"),
        ({"place": PLACE, "plane": "x", "angle": 2e-4}, "angle must be a number from -0.0001"),
        ({"place": "QM1A_C30", "plane": "x", "angle": 1e-6}, "the angle at QM1A_C30 is not known"),
        ({"place": "10.0", "plane": "x", "position": 1e-6}, "lies a magnet"),
    ],
)
def test_what_is_refused_changes_nothing(bench: Bench, request_: Any, words: str):
    with pytest.raises(ControlError, match=words):
        bench("bump", **request_)
    assert not reference(bench).any() and not bench.adjuster._bumps.in_force


def test_it_is_refused_where_the_whole_reference_or_a_corrector_would_be_beyond_its_limit(
    bench: Bench,
):
    bench("reference", values=[9e-4] * N)
    with pytest.raises(ControlError, match=r"the reference goes up to .* \(panel.reference_limit"):
        bench("bump", place=PLACE, plane="x", position=4e-4)
    np.testing.assert_array_equal(reference(bench), 9e-4)
    asked: list[Any] = []

    def crossed(change: Any) -> str:
        asked.append(change)
        return "CL1B"

    bumps = Bumps(RING, CHANNELS, PanelSettings(), lambda: np.ones(M, dtype=bool), crossed)
    with pytest.raises(ControlError, match="bump refused: CL1B would go beyond their limits"):
        bumps.asked({"place": PLACE, "plane": "x", "position": 1e-4}, NOTHING)
    kicks = closed_bump(RING, "x", SOURCE, 1e-4).kicks / RING.calibration("x")
    np.testing.assert_allclose(asked[0][CHANNELS.corrector_parts["x"]], kicks)

"""Closed bumps against tracking, and against what a drift says."""

import numpy as np
import pytest
from lazily import Lazy

from orbitfb.core.errors import RingError
from orbitfb.physics.bump import closed_bump, find_source
from orbitfb.physics.optics import green
from orbitfb.physics.places import Ring

at = Lazy("at")

STRAIGHT = "PL1B_C30,PL1A_C01"


def with_marker(lattice, s):
    """The lattice cut in two at s, and the index there."""
    cut = lattice.sbreak([s])
    return cut, int(np.argmin(np.abs(cut.get_s_pos(np.arange(len(cut) + 1)) - s)))


@pytest.mark.parametrize("plane", ["x", "y"])
@pytest.mark.parametrize("place", ["middle", "BPM"])
def test_position_and_angle_are_those_of_tracking_and_the_rest_stays(tracked, plane, place):
    ring, row = tracked.ring, "xy".index(plane)
    bpm = ring.table.name.index("P14")
    after = ring.table.name[bpm + 1]
    source = find_source(ring, f"P14,{after}" if place == "middle" else "P14")
    bump = closed_bump(ring, plane, source, 20e-6, -30e-6)
    for number, kick in enumerate(bump.kicks):
        tracked.kick(number, *((kick, 0.0) if plane == "x" else (0.0, kick)))
    lattice, here = with_marker(tracked.lattice, source.s)
    _, orbit = at.find_sync_orbit(lattice, refpts=[here])
    assert orbit[0, 2 * row] == pytest.approx(20e-6, rel=1e-4)
    assert orbit[0, 2 * row + 1] == pytest.approx(-30e-6, rel=1e-4)
    seen = tracked.orbit()
    np.testing.assert_allclose(seen[row], bump.orbit, atol=5e-9)  # second order of 20 µm
    assert np.count_nonzero(bump.orbit) <= 8 < len(bump.orbit)
    assert np.abs(seen[row][bump.orbit == 0]).max() < 5e-9
    assert np.count_nonzero(bump.kicks) == 6


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_source_of_a_straight_is_seen_by_the_bpms_at_its_ends(plane):
    ring = Ring.load()
    source = find_source(ring, STRAIGHT)
    assert source.s == pytest.approx(26.3997, abs=1e-4)
    bump = closed_bump(ring, plane, source, 100e-6, 20e-6)
    names = ring.names("BPM")
    left, right = (bump.orbit[names.index(name)] for name in STRAIGHT.split(","))
    length = 29.98860 - 22.81090
    assert (right - left) / length == pytest.approx(20e-6, rel=1e-6)
    assert (right + left) / 2 == pytest.approx(100e-6, rel=1e-6)
    whole = green(ring, "BPM", "COR", plane) @ bump.kicks
    np.testing.assert_allclose(whole, bump.orbit, atol=1e-12)
    assert np.count_nonzero(bump.orbit) < 12


def test_it_is_linear_and_one_across_the_beginning_of_the_table_is_like_any_other():
    ring = Ring.load()
    last = find_source(ring, f"{ring.table.name[-1]},{ring.table.name[0]}")
    assert last.has_angle and (last.s < 4.75 or last.s > 787.0)
    one = closed_bump(ring, "x", last, 50e-6, 0.0)
    two = closed_bump(ring, "x", last, 0.0, 10e-6)
    both = closed_bump(ring, "x", last, -100e-6, 20e-6)
    np.testing.assert_allclose(both.orbit, 2 * two.orbit - 2 * one.orbit, atol=1e-12)


def test_correctors_that_may_not_move_have_no_part():
    ring = Ring.load()
    source = find_source(ring, STRAIGHT)
    first = closed_bump(ring, "x", source, 1e-4)
    movable = first.kicks == 0
    other = closed_bump(ring, "x", source, 1e-4, movable=movable)
    assert not (other.kicks[~movable]).any() and np.count_nonzero(other.kicks) == 6


def test_where_there_is_no_drift_only_the_position_is_known():
    ring = Ring.load()
    source = find_source(ring, "QM1A_C30")
    assert not source.has_angle
    assert not find_source(ring, "CL1A_C01").has_angle  # it kicks itself
    bump = closed_bump(ring, "x", source, 50e-6)
    index = np.array([ring.table.name.index("QM1A_C30")])
    assert green(ring, index, "COR", "x") @ bump.kicks == pytest.approx(50e-6)
    with pytest.raises(RingError, match="the angle at QM1A_C30 is not known"):
        closed_bump(ring, "x", source, 50e-6, 1e-6)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("PL1A_C1", r"no source 'PL1A_C1' \(did you mean PL1A_C11"),
        ("PL1A_C01,PL9", "no source 'PL1A_C01,PL9'"),
        ("900", "s = 900 m is not on the ring"),
        ("nan", "s = nan m is not on the ring"),
        ("10", "between CH2A_C30 and CM1A_C30 lies a magnet"),
    ],
)
def test_what_is_no_source_is_told(name, words):
    with pytest.raises(RingError, match=words):
        find_source(Ring.load(), name)


def test_too_few_correctors_make_no_closed_bump():
    ring = Ring.load()
    source = find_source(ring, STRAIGHT)
    few = np.zeros(180, dtype=bool)
    few[:6] = True
    with pytest.raises(RingError, match="takes at least 4 correctors"):
        closed_bump(ring, "x", source, 1e-4, movable=few)

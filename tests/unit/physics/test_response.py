"""The default ring's response matrix against the tracked one, and its drawn drift."""

from pathlib import Path

import numpy as np
import pytest

from orbitfb.core.errors import RingError
from orbitfb.physics.optics import beta_beat, green, green_with_gradient_errors
from orbitfb.physics.response import response, seeded_gradient_errors

TRACKED = Path(__file__).resolve().parents[4] / "shared" / "data" / "ring" / "ring_orm.npz"


def relative(found, wanted):
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_default_ring_is_the_tracked_one(ring, plane):
    if not TRACKED.exists():
        pytest.skip(f"the tracked matrices are not on this computer ({TRACKED})")
    with np.load(TRACKED) as data:
        wanted = data[f"R1_{plane}"] * 1e-3  # mm/A
        names = tuple(data[f"bpm_names_{plane}"]), tuple(data[f"corr_names_{plane}"])
    channels = ring.channels(plane)
    assert (channels.orbit_pvs, channels.setpoint_pvs) == names
    # tracked by kicks of ±5 µrad with sextupoles on, whose third order is 5e-6
    assert relative(response(ring, plane), wanted) < 1e-5


def test_the_singular_values_are_the_stated_ones(ring):
    x, y = (np.linalg.svd(response(ring, plane), compute_uv=False) for plane in ("x", "y"))
    np.testing.assert_allclose(x[[0, 2, 99, 179]], [43.6e-3, 13e-3, 39.1e-6, 18.3e-6], rtol=5e-3)
    np.testing.assert_allclose(y[[0, 2, 99, 179]], [49.8e-3, 16.9e-3, 70.6e-6, 31.5e-6], rtol=5e-3)


def test_both_planes_are_block_diagonal(ring):
    both = response(ring, "xy")
    assert both.shape == (360, 360)
    np.testing.assert_array_equal(both[:180, :180], response(ring, "x"))
    np.testing.assert_array_equal(both[180:, 180:], response(ring, "y"))
    assert not both[:180, 180:].any()
    assert not both[180:, :180].any()


@pytest.mark.parametrize("seed", range(4))
def test_the_drawn_errors_make_the_asked_beat_and_about_a_tenth_of_change(ring, seed):
    errors = seeded_gradient_errors(ring, 0.07, seed)
    assert np.sqrt(np.mean(beta_beat(ring, "BPM", "x", errors) ** 2)) == pytest.approx(0.07)
    nominal = response(ring, "x")
    assert 0.05 < relative(response(ring, "x", errors), nominal) < 0.15
    np.testing.assert_array_equal(errors, seeded_gradient_errors(ring, 0.07, seed))


def test_the_drawn_errors_leave_the_tunes_alone(ring):
    errors = seeded_gradient_errors(ring, 0.07, 0)
    shift = ring.table.beta[:, ring.places("QUAD")] @ errors / (4 * np.pi)
    np.testing.assert_allclose(shift, 0, atol=1e-12)


def test_without_errors_the_formula_changes_nothing(ring):
    zeros = np.zeros(300)
    np.testing.assert_array_equal(
        green_with_gradient_errors(ring, "BPM", "COR", "x", zeros),
        green(ring, "BPM", "COR", "x"),
    )


@pytest.mark.parametrize("errors", [np.zeros(299), np.full(300, np.nan)])
def test_gradient_errors_must_be_one_finite_value_per_quadrupole(ring, errors):
    with pytest.raises(RingError, match=r"300 quadrupoles; give one finite value"):
        response(ring, "x", errors)

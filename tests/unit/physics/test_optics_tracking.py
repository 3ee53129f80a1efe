"""The optics against tracking by accelerator-toolbox: an oracle that shares no equation."""

import numpy as np
import pytest
from lazily import Lazy
from numpy.testing import assert_allclose

from orbitfb.core.errors import RingError
from orbitfb.physics.optics import (
    angles_around,
    beta_beat,
    energy_orbit,
    green,
    green_with_gradient_errors,
    rf_orbit,
)
from orbitfb.physics.response import quadrupole_displacement_response, response
from orbitfb.physics.sextupoles import SextupoleOrbit

at = Lazy("at")

CORRECTORS = 16


def relative(found, wanted):
    return np.linalg.norm(found - wanted) / np.linalg.norm(wanted)


def gradient_errors(tracked, rms):
    errors = rms * np.random.default_rng(1).standard_normal(len(tracked.quadrupoles))
    for place, error in zip(tracked.quadrupoles, errors, strict=True):
        tracked.lattice[place].PolynomB[1] += error
    return errors


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_response_is_that_of_tracking(tracked, plane):
    # 1e-8: what central differences of 1 µrad leave in the tracked one
    assert relative(green(tracked.ring, "BPM", "COR", plane), tracked.response(plane)) < 1e-8


def test_without_its_dispersion_term_the_response_would_be_wrong(tracked):
    ring = tracked.ring
    eta_bpm, eta_cor = (ring.table.dispersion[ring.places(kind)] for kind in ("BPM", "COR"))
    stretch = ring.parameters.alpha_c * ring.parameters.circumference
    betatron_only = green(ring, "BPM", "COR", "x") + np.outer(eta_bpm, eta_cor) / stretch
    assert relative(betatron_only, tracked.response("x")) > 0.03


def test_the_response_per_ampere_has_the_calibration_and_both_planes(tracked):
    both = response(tracked.ring, "xy")
    wanted = np.zeros_like(both)
    n, m = len(tracked.bpms), len(tracked.correctors)
    wanted[:n, :m] = tracked.response("x") * 4e-5
    wanted[n:, m:] = tracked.response("y") * 6e-5
    assert relative(both, wanted) < 1e-8


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_gradient_error_formula_is_exact_for_thin_quadrupoles(tracked, plane):
    errors = gradient_errors(tracked, rms=0.01)
    tracked_response = tracked.response(plane)
    formula = green_with_gradient_errors(tracked.ring, "BPM", "COR", plane, errors)
    assert relative(formula, tracked_response) < 1e-8
    assert relative(green(tracked.ring, "BPM", "COR", plane), tracked_response) > 0.05


@pytest.mark.parametrize(("plane", "column"), [("x", 0), ("y", 1)])
def test_the_beta_beat_is_that_of_tracking_to_first_order(tracked, plane, column):
    before = at.get_optics(tracked.lattice, tracked.bpms)[2].beta[:, column]
    errors = gradient_errors(tracked, rms=1e-5)
    after = at.get_optics(tracked.lattice, tracked.bpms)[2].beta[:, column]
    first_order = beta_beat(tracked.ring, "BPM", plane, errors)
    # the errors make a beat of 1e-4, so the second order is about 1e-4 of it
    assert relative(first_order, after / before - 1) < 1e-3


@pytest.mark.parametrize(("plane", "row"), [("x", 0), ("y", 1)])
def test_a_displaced_quadrupole_moves_the_orbit_as_in_tracking(tracked, plane, row):
    shift = 1e-7
    wanted = []
    for place in tracked.quadrupoles:
        element = tracked.lattice[place]
        vector = np.zeros(6)
        vector[2 * row] = shift
        element.T1, element.T2 = -vector, vector
        there = tracked.orbit()[row]
        element.T1, element.T2 = vector, -vector
        wanted.append((there - tracked.orbit()[row]) / (2 * shift))
        del element.T1, element.T2
    found = quadrupole_displacement_response(tracked.ring, plane)
    assert relative(found, np.array(wanted).T) < 1e-7


def test_an_energy_deviation_makes_the_dispersion_orbit(tracked):
    orbits = [
        at.find_orbit4(tracked.lattice, dp=deviation, refpts=tracked.bpms)[1][:, 0]
        for deviation in (1e-5, -1e-5)
    ]
    assert relative(energy_orbit(tracked.ring, "BPM", 1e-5), (orbits[0] - orbits[1]) / 2) < 1e-6


def test_an_rf_change_makes_the_dispersion_orbit(tracked):
    lengthening = 1e-6
    orbit = (tracked.orbit(lengthening)[0] - tracked.orbit(-lengthening)[0]) / 2
    # a longer turn is a lower frequency
    change = -tracked.ring.rf_frequency * lengthening / tracked.ring.parameters.circumference
    assert relative(rf_orbit(tracked.ring, "BPM", change), orbit) < 1e-6


@pytest.mark.parametrize(("plane", "close"), [("x", 0.05), ("y", 1e-4)])
def test_an_orbit_lowers_the_energy_by_its_length_as_in_tracking(tracked, plane, close):
    """Kicks of both signs leave what is of second order; horizontally bends add to it."""
    ring, row = tracked.ring, "xy".index(plane)
    kicks = 2e-4 * np.random.default_rng(3).standard_normal(CORRECTORS)
    even = -tracked.orbit()[0]
    for sign in (1.0, -1.0):
        for corrector, kick in enumerate(sign * kicks):
            tracked.kick(corrector, *(kick if one == row else 0.0 for one in range(2)))
        even += 0.5 * tracked.orbit()[0]
    s, places = np.unique(ring.table.s, return_index=True)
    around = ring.parameters.circumference
    angles = angles_around(s, green(ring, places, "COR", plane) @ kicks, around)
    lower = energy_orbit(ring, "BPM", -0.5 * np.sum(angles**2) / (ring.parameters.alpha_c * around))
    assert even @ lower / (lower @ lower) == pytest.approx(1.0, rel=close)
    if plane == "y":
        assert relative(lower, even) < close


@pytest.mark.parametrize("seed", range(3))
def test_the_sextupoles_bend_the_closed_orbit_as_in_tracking(tracked_with_sextupoles, seed):
    tracked = tracked_with_sextupoles
    kicks_x, kicks_y = 5e-5 * np.random.default_rng(seed).standard_normal((2, CORRECTORS))
    for corrector, (kick_x, kick_y) in enumerate(zip(kicks_x, kicks_y, strict=True)):
        tracked.kick(corrector, kick_x, kick_y)
    with_sextupoles = tracked.orbit()
    for place in tracked.sextupoles:
        tracked.lattice[place].PolynomB[2] = 0.0
    bent = with_sextupoles - tracked.orbit()

    solution = SextupoleOrbit(tracked.ring).solve(kicks_x, kicks_y)
    linear = [
        green(tracked.ring, "BPM", "COR", plane) @ kicks
        for plane, kicks in (("x", kicks_x), ("y", kicks_y))
    ]
    # 2 % of what the sextupoles do: thin optics know neither the quadrupoles' chromaticity nor
    # the path length of second order
    assert np.sqrt(np.mean(bent**2)) > 1e-6
    assert relative(np.stack([solution.x - linear[0], solution.y - linear[1]]), bent) < 0.02


def test_kicks_beyond_the_sextupoles_reach_are_refused(tracked_with_sextupoles):
    solver = SextupoleOrbit(tracked_with_sextupoles.ring)
    with pytest.raises(RingError, match=r"no closed orbit .* 0.1 rad; make the kicks smaller"):
        solver.solve(np.full(CORRECTORS, 0.1), np.full(CORRECTORS, 0.1))


def test_without_kicks_the_orbit_is_straight(tracked_with_sextupoles):
    solution = SextupoleOrbit(tracked_with_sextupoles.ring).solve(
        np.zeros(CORRECTORS), np.zeros(CORRECTORS)
    )
    assert_allclose(np.stack([solution.x, solution.y]), 0.0, atol=0)

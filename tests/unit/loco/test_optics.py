"""Slopes by finite differences, tunes and beta-beat by a second way."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.loco.coupling import fit_coupling
from orbitfb.loco.fit import PlaneFit
from orbitfb.loco.measured import Measured
from orbitfb.loco.normal import Piece, normal_equations
from orbitfb.loco.optics import RingOptics, turned
from orbitfb.loco.run import diagnose
from orbitfb.measure.screen import row_sizes
from orbitfb.physics.optics import green, green_with_gradient_errors
from orbitfb.physics.places import Ring
from tests.unit.loco.synthetic_responses import NOISE, devices, synthetic


@pytest.fixture(scope="module")
def optics() -> RingOptics:
    from orbitfb.physics.places import Ring

    ring = Ring.load()
    return RingOptics(ring, devices(ring, 9))


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_response_with_errors_is_that_of_the_physics(optics: RingOptics, plane) -> None:
    relative = 0.005 * np.random.default_rng(1).standard_normal(len(optics.quadrupoles))
    ring = optics.ring
    wanted = green_with_gradient_errors(
        ring, ring.places("BPM")[::9], devices(ring, 9).correctors[plane], plane,
        relative * optics.strength,
    )  # fmt: skip
    assert np.allclose(optics.at(relative)[plane].own, wanted, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_slope_by_a_gradient_is_the_outer_product(optics: RingOptics, plane) -> None:
    base = 0.003 * np.random.default_rng(2).standard_normal(len(optics.quadrupoles))
    step = np.zeros_like(base)
    step[17] = 1e-6
    both = [optics.at(base + sign * step)[plane].own for sign in (1, -1)]
    slope = (both[0] - both[1]) / 2e-6
    its = optics.at(base)[plane]
    sign = -1 if plane == "x" else 1
    wanted = sign * optics.strength[17] * np.outer(its.left[:, 17], its.right[17])
    assert np.allclose(slope, wanted, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_slope_by_the_phase_is_that_of_a_moved_place(optics: RingOptics, plane) -> None:
    ring = optics.ring
    bpms, correctors = ring.places("BPM")[::9], ring.places("COR")[::9]
    row, step = 0 if plane == "x" else 1, 1e-6
    moved = []
    for sign in (1, -1):
        phase = ring.table.phase.copy()
        phase[row, bpms] += sign * step
        other = replace(
            ring,
            table=replace(ring.table, phase=phase, dispersion=0 * ring.table.dispersion),
        )
        moved.append(green(other, bpms, correctors, plane))
    assert np.allclose((moved[0] - moved[1]) / (2 * step), turned(ring, bpms, correctors, plane),
                       atol=1e-5)  # fmt: skip


@pytest.mark.parametrize("plane", ["x", "y"])
def test_the_tune_and_beta_follow_first_order_for_small_errors(optics: RingOptics, plane) -> None:
    ring, row = optics.ring, 0 if plane == "x" else 1
    relative = 1e-5 * np.random.default_rng(3).standard_normal(len(optics.quadrupoles))
    sign = 1 if plane == "x" else -1
    beta = ring.table.beta[row, optics.quadrupoles]
    wanted = sign * float(relative * optics.strength @ beta) / (4 * np.pi)
    assert optics.tune(plane, relative) - ring.tune(plane) == pytest.approx(wanted, rel=0.02)
    from orbitfb.physics.optics import beta_beat

    places = ring.places("BPM")
    first = beta_beat(ring, places, plane, relative * optics.strength)
    assert np.allclose(optics.beta_beat(plane, relative, places), first, atol=1e-2 * first.std())


def test_normal_equations_are_those_of_a_dense_jacobian() -> None:
    rng = np.random.default_rng(4)
    n, m, q = 5, 6, 4
    kept = rng.random((n, m)) > 0.2
    rows = [(rng.normal(size=(n, m)), np.arange(n))]
    columns = [(rng.normal(size=(n, m)), n + np.arange(m))]
    left, right = rng.normal(size=(n, q)), rng.normal(size=(q, m))
    u, v = rng.random(n) + 0.5, rng.random(m) + 0.5
    residual = rng.normal(size=(n, m))
    piece = Piece(residual, kept, u, v, rows, columns, left, right, n + m + np.arange(q))
    matrix, pull = normal_equations([piece], n + m + q)
    dense = np.zeros((n, m, n + m + q))
    for i in range(n):
        dense[i, :, i] = rows[0][0][i]
    for j in range(m):
        dense[:, j, n + j] = columns[0][0][:, j]
    dense[:, :, n + m :] = np.einsum("iq,qj->ijq", left, right)
    weight = np.where(kept, np.outer(u, v), 0.0)
    assert np.allclose(matrix, np.einsum("ijk,ij,ijl->kl", dense, weight, dense))
    assert np.allclose(pull, np.einsum("ijk,ij,ij->k", dense, weight, residual))


def test_rolls_tilts_and_their_signs_come_back() -> None:
    truth = synthetic(11, noise=0.1 * NOISE)
    own = truth.measured
    optics = RingOptics(truth.ring, own)
    its = optics.at(truth.gradient)
    rng = np.random.default_rng(5)
    n, m = len(own.bpms["x"]), {p: len(own.correctors[p]) for p in "xy"}
    roll = 0.005 * rng.standard_normal(n)
    roll[8] = 0.1
    tilt = 0.004 * rng.standard_normal(m["y"])
    orbit_y = its["y"].own * truth.kick["y"]
    cross = roll[:, None] * orbit_y + truth.gain["x"][:, None] * its["x"].other * tilt
    cross = cross + 0.1 * NOISE * rng.standard_normal(cross.shape)
    response = {**own.response, ("x", "y"): cross}
    sigma = {**own.sigma, ("x", "y"): np.full(cross.shape, np.nan)}
    measured = Measured(own.bpms, own.correctors, response, sigma)
    fit = PlaneFit(optics, measured).run()
    found = fit_coupling(optics, measured, fit)
    assert found is not None
    assert np.allclose(found.part("roll:x"), roll, atol=0.003)
    assert np.allclose(found.part("tilt:y"), tilt, atol=0.003)
    assert np.flatnonzero(found.free[found.groups.of["roll:x"]]).tolist() == [8]
    assert np.std(found.residual["x", "y"]) < 0.12 * NOISE


@pytest.mark.nightly
def test_a_measured_dispersion_helps_and_its_scale_is_free() -> None:
    truth = synthetic(12, gradients=0.002)
    optics = RingOptics(truth.ring, truth.measured)
    eta = truth.gain["x"] * optics.at(truth.gradient)["x"].dispersion * 1.07
    given = replace(truth.measured, dispersion=eta, dispersion_sigma=1e-5)
    without, fit = PlaneFit(optics, truth.measured).run(), PlaneFit(optics, given).run()
    assert fit.part("rf")[0] == pytest.approx(0.07, abs=0.01)
    apart = [np.std(one.part("gradient") - truth.gradient) for one in (fit, without)]
    assert apart[0] < apart[1]


@pytest.mark.nightly
def test_a_table_that_is_off_by_a_tenth_in_tune_is_no_matter_of_units() -> None:
    """Near an integer tune a response is four times as large; the fit gets there."""
    strong = Ring.load().names("QUAD").index("QL2A_C09")
    truth = synthetic(12, gradients=0.0, faults={("gradient", "", strong): -0.055})
    found = diagnose(truth.ring, truth.measured)
    assert row_sizes(truth.measured.response["x", "x"], found.nominal["x"]).mean() > 3.0
    wanted = found.optics.tune("x", truth.gradient)
    assert wanted < truth.ring.tune("x") - 0.12
    fitted = found.optics.tune("x", found.fit.part("gradient"))
    assert fitted == pytest.approx(wanted, abs=1e-3)
    assert found.named[0].places == ("QL2A_C09",)

"""Families of devices, and findings that are told together."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.loco.coupling import fit_coupling
from orbitfb.loco.families import families_of, middles
from orbitfb.loco.fit import PlaneFit
from orbitfb.loco.measured import Measured
from orbitfb.loco.named import Named
from orbitfb.loco.optics import RingOptics
from orbitfb.loco.run import diagnose
from orbitfb.loco.together import rows_together
from tests.unit.loco.synthetic_responses import NOISE, synthetic


def test_values_around_three_middles_are_three_families() -> None:
    rng = np.random.default_rng(2)
    truth = np.repeat([0, 1, 2], (33, 17, 4))
    value = np.array([1.09, 0.94, 1.25])[truth] + 0.015 * rng.standard_normal(54)
    order = rng.permutation(54)
    label = families_of(value[order], 1e-3)
    assert label.tolist() == truth[order].tolist()
    assert middles(value[order], label)[order == 53] == pytest.approx(np.median(value[50:]))


@pytest.mark.parametrize("count", [48, 120, 240])
def test_normal_values_are_one_family(count: int) -> None:
    rng = np.random.default_rng(3)
    labels = [families_of(rng.standard_normal(count), 1e-3) for _ in range(300)]
    assert not any(label.any() for label in labels)


def test_values_that_are_nearer_than_they_are_known_are_one_family() -> None:
    value = np.repeat([0.0, 1e-3], (20, 10))
    assert not families_of(value, 1e-3).any()
    assert families_of(value, 1e-5).any()


def test_a_few_beyond_a_gap_that_do_not_stand_out_are_no_family() -> None:
    value = np.clip(np.random.default_rng(4).standard_normal(48), -1.5, 1.5)
    assert not families_of(np.concatenate([value, np.full(4, 3.6)]), 1e-3).any()
    assert families_of(np.concatenate([value, np.full(4, 7.2)]), 1e-3).any()


@pytest.mark.nightly
def test_a_family_that_families_hide_is_told_and_a_device_beside_its_own() -> None:
    few, many = (3, 9, 14, 22), tuple(range(24, 40))
    faults = {("kick", "x", k): 1.16 for k in few} | {("kick", "x", k): 0.86 for k in many}
    truth = synthetic(13, gains=0.01, faults=faults | {("kick", "x", 30): 0.78})
    found = diagnose(truth.ring, truth.measured)
    labels = [f"{truth.ring.table.name[j]}:x" for j in truth.measured.correctors["x"]]
    told = {its.places: its.value for its in found.named if its.stands_out}
    hidden, other = tuple(labels[k] for k in few), tuple(labels[k] for k in many if k != 30)
    assert set(told) == {hidden, other, (labels[30],)}
    assert told[hidden] == pytest.approx(0.16, abs=0.01)
    assert told[other] == pytest.approx(-0.14, abs=0.01)
    assert found.estimates["calibration:x"].spread < 0.02


@pytest.mark.nightly
def test_a_device_that_nearly_stands_out_is_told_beside_the_answer() -> None:
    truth = synthetic(21, gains=0.02)
    spread = diagnose(truth.ring, truth.measured).estimates["gain:x"].spread
    own = truth.measured.response["x", "x"]
    own[5] *= (1.0 - 4.5 * spread) / truth.gain["x"][5]
    found = diagnose(truth.ring, truth.measured)
    place = f"{truth.ring.table.name[truth.measured.bpms['x'][5]]}:x"
    its = next(one for one in found.named if one.places == (place,))
    assert 4.0 < its.z < 5.0
    assert not replace(its, probability=0.99).stands_out
    assert replace(its, probability=0.99, z=5.0).stands_out
    assert not replace(its, z=5.0, probability=0.5).stands_out


@pytest.mark.nightly
def test_a_sextupole_that_couples_the_planes_is_named() -> None:
    truth = synthetic(11, noise=0.1 * NOISE)
    own = truth.measured
    optics = RingOptics(truth.ring, own)
    at = optics.at(truth.gradient)
    which = len(optics.quadrupoles) + 100
    response, sigma = dict(own.response), dict(own.sigma)
    rng = np.random.default_rng(6)
    for read, driven in (("x", "y"), ("y", "x")):
        left, _ = optics.at_skews(read, truth.gradient, at[read])
        _, right = optics.at_skews(driven, truth.gradient, at[driven])
        orbit = 0.02 * np.outer(left[:, which], right[which] * truth.kick[driven])
        cross = truth.gain[read][:, None] * orbit
        response[read, driven] = cross + 0.1 * NOISE * rng.standard_normal(cross.shape)
        sigma[read, driven] = np.full(cross.shape, np.nan)
    measured = Measured(own.bpms, own.correctors, response, sigma)
    found = diagnose(truth.ring, measured)
    told = [its for its in found.named if its.stands_out]
    assert [(its.kind, its.places) for its in told] == [
        ("skew-coupling", (truth.ring.names("SEXT")[100],))
    ]
    assert told[0].value == pytest.approx(0.02, rel=0.1)
    assert "Sextupole" in told[0].text


def test_skew_places_see_the_fitted_optics() -> None:
    truth = synthetic(12, gradients=0.004)
    optics = RingOptics(truth.ring, truth.measured)
    for plane, its in optics.at(truth.gradient).items():
        left, right = optics.at_skews(plane, truth.gradient, its)
        quadrupoles = len(optics.quadrupoles)
        assert np.allclose(left[:, :quadrupoles], its.left)
        assert np.allclose(right[:quadrupoles], its.right)
    assert fit_coupling(optics, truth.measured, PlaneFit(optics, truth.measured).run()) is None


def _row(place: str, phase: float, z: float, kind: str = "bpm-row") -> Named:
    return Named(kind, (place,), phase, 0.001, "rad", z, 0.999, place)


def test_rows_that_are_off_the_same_way_are_one_finding() -> None:
    rows = [_row(f"B{k}:y", -0.01 * k, 10.0 + k) for k in range(1, 10)]
    others = [_row("B20:y", 0.02, 8.0), _row("B1:x", -0.02, 7.0), _row("B2:x", -0.02, 7.0)]
    found = rows_together([*rows, *others])
    assert [len(its.places) for its in found] == [1, 1, 1, 9]
    assert found[-1].places[0] == "B9:y"
    assert found[-1].value == pytest.approx(-0.09)
    assert "9 rows of BPMs in y" in found[-1].text
    assert "B9:y -90" in found[-1].text
    assert rows_together(rows[:3]) == rows[:3]

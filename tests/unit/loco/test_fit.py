"""The fit against a synthetic truth, and the answers to bad input."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.errors import RingError
from orbitfb.loco.answer import answer_of, verdict
from orbitfb.loco.growth import growths
from orbitfb.loco.run import diagnose
from orbitfb.loco.schema import ResponseDiagnosis, document
from tests.unit.loco.synthetic_responses import NOISE, synthetic


@pytest.fixture(scope="module")
def faulty():
    """A ring with a reversed and a wrong BPM, a strong corrector and a wrong quadrupole."""
    truth = synthetic(
        3,
        faults={
            ("gain", "x", 7): 1.4,
            ("gain", "y", 20): -1.0,
            ("kick", "x", 11): 0.7,
            ("gradient", "", 100): 0.05,
        },
        known=True,
    )
    return truth, diagnose(truth.ring, truth.measured)


def test_the_fit_reaches_the_noise_and_gives_gains_and_kicks_back(faulty) -> None:
    truth, found = faulty
    assert found.fit.converged
    for plane in "xy":
        left = found.fit.residual[plane]
        assert np.std(left) < 1.05 * NOISE
        gain = found.estimates[f"gain:{plane}"]
        healthy = ~gain.free
        wanted = truth.gain[plane] / truth.gain[plane][healthy].mean() - 1
        pull = (gain.value - wanted) / gain.sigma
        assert np.abs(gain.value - wanted).max() < 0.01
        assert 0.5 < np.std(pull[healthy]) < 1.4
        kick = found.estimates[f"calibration:{plane}"]
        assert np.allclose(
            kick.value, truth.kick[plane] * truth.gain[plane][healthy].mean(), atol=0.01
        )


def test_devices_that_stand_out_are_named_and_no_others(faulty) -> None:
    truth, found = faulty
    name = truth.ring.table.name
    bpm = [name[i] for i in truth.measured.bpms["x"]]
    told = {(its.kind, its.places[0]) for its in found.named}
    assert (("bpm-gain", f"{bpm[7]}:x")) in told
    assert (("bpm-polarity", f"{bpm[20]}:y")) in told
    assert ("corrector-gain", f"{name[truth.measured.correctors['x'][11]]}:x") in told
    gradients = [its for its in found.named if its.kind == "quadrupole-gradient"]
    assert len(gradients) == 1
    wanted = truth.ring.names("QUAD")[100]
    places = {gradients[0].places[0], *(place for place, _ in gradients[0].alternatives)}
    assert wanted in places
    assert len(found.named) == 4


def test_the_answer_is_whole_json_and_says_gauge_and_optics(faulty) -> None:
    truth, found = faulty
    growth = growths(truth.ring, truth.measured, found.nominal)
    answer = answer_of(found, "m.csv", (), growth)
    again = ResponseDiagnosis.model_validate_json(document(answer))
    assert again == answer
    assert answer.state in ("named", "ambiguous")
    own = {its.plane: its for its in answer.optics}
    for plane in "xy":
        wanted = found.optics.tune(plane, truth.gradient)
        assert own[plane].tune_fit == pytest.approx(wanted, abs=2e-4)
    assert "1 on average" in answer.gauge
    assert answer.blocks[0].chi2_after < 1.2 < answer.blocks[0].chi2_before


def test_a_reversed_bpm_makes_the_loop_grow_and_it_is_told(faulty) -> None:
    truth, found = faulty
    growth = growths(truth.ring, truth.measured, found.nominal)
    by_plane = {its.planes: its for its in growth}
    assert by_plane["y"].per_tick > 1.0001
    assert "lose the beam" in by_plane["y"].text


def test_nothing_is_named_on_a_healthy_ring() -> None:
    truth = synthetic(5, gains=0.03, gradients=0.002)
    found = diagnose(truth.ring, truth.measured)
    assert found.named == ()
    state, headline = verdict(found)
    assert state == "no_gap"
    assert "everywhere" in headline


def test_a_table_with_a_tune_that_is_off_is_reached() -> None:
    truth = synthetic(6, gradients=0.004, gains=0.01)
    found = diagnose(truth.ring, truth.measured)
    off = {p: abs(found.optics.tune(p, truth.gradient) - truth.ring.tune(p)) for p in "xy"}
    assert max(off.values()) > 0.01
    for plane in "xy":
        tune = found.optics.tune(plane, found.fit.part("gradient"))
        assert tune == pytest.approx(found.optics.tune(plane, truth.gradient), abs=5e-4)
        assert np.std(found.fit.residual[plane]) < 1.2 * NOISE


def test_exchanged_and_dead_devices_are_named_and_put_right() -> None:
    truth = synthetic(7)
    response = dict(truth.measured.response)
    data = response["x", "x"].copy()
    data[[3, 30]] = data[[30, 3]]
    data[12] *= 0.001
    data[:, [5, 21]] = data[:, [21, 5]]
    response["x", "x"] = data
    found = diagnose(truth.ring, replace(truth.measured, response=response))
    told = {its.kind: its.places for its in found.named}
    name = truth.ring.table.name
    bpm = [f"{name[i]}:x" for i in truth.measured.bpms["x"]]
    corrector = [f"{name[i]}:x" for i in truth.measured.correctors["x"]]
    assert told == {
        "bpm-swap": (bpm[3], bpm[30]),
        "bpm-dead": (bpm[12],),
        "corrector-swap": (corrector[5], corrector[21]),
    }
    assert np.std(found.fit.residual["x"][found.fit.noise["x"].kept]) < 1.1 * NOISE


def test_a_row_of_another_place_is_not_of_this_lattice() -> None:
    truth = synthetic(8)
    data = truth.measured.response["y", "y"]
    ring = truth.ring
    from orbitfb.loco.optics import turned

    shift = turned(ring, truth.measured.bpms["y"], truth.measured.correctors["y"], "y")
    data[9] += 0.2 * shift[9]
    found = diagnose(ring, truth.measured)
    first = found.named[0]
    assert first.kind == "bpm-row"
    assert first.places == (f"{ring.table.name[truth.measured.bpms['y'][9]]}:y",)
    assert first.value == pytest.approx(0.2, rel=0.15)


def test_a_single_wild_element_is_an_outlier_and_is_shown() -> None:
    truth = synthetic(9)
    truth.measured.response["x", "x"][4, 8] += 60 * NOISE
    found = diagnose(truth.ring, truth.measured)
    assert np.argwhere(found.fit.noise["x"].outliers).tolist() == [[4, 8]]
    answer = answer_of(found, "m.csv", (), ())
    assert len(answer.outliers) == 1
    assert answer.outliers[0].sigmas == pytest.approx(60, rel=0.2)
    assert found.named == ()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: np.roll(m, 1, axis=0), "rows are shifted by 1"),
        (lambda m: -np.roll(m, 1, axis=0), "opposite sign"),
        (lambda m: -m, "opposite sign of the optics"),
        (lambda m: m.T, "transposed"),
        (lambda m: m[::-1], "opposite order"),
        (lambda m: np.random.default_rng(1).permutation(m), "another ring"),
    ],
)
def test_another_order_is_refused_with_what_it_looks_like(change, told: str) -> None:
    truth = synthetic(10)
    response = dict(truth.measured.response)
    response["x", "x"] = change(response["x", "x"])
    with pytest.raises(RingError, match=told):
        diagnose(truth.ring, replace(truth.measured, response=response))


def test_the_other_plane_is_told() -> None:
    truth = synthetic(10)
    own = truth.measured
    same = replace(
        own,
        correctors={"x": own.correctors["y"], "y": own.correctors["y"]},
        response={("x", "x"): own.response["y", "y"], ("y", "y"): own.response["y", "y"]},
    )
    with pytest.raises(RingError, match="of the other plane"):
        diagnose(truth.ring, same)

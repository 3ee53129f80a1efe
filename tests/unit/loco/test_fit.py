"""The fit against a synthetic truth, and the answers to bad input."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.errors import RingError
from orbitfb.loco.answer import answer_of, verdict
from orbitfb.loco.growth import growths
from orbitfb.loco.measured import Measured
from orbitfb.loco.optics import RingOptics
from orbitfb.loco.output.effects import fragment
from orbitfb.loco.run import diagnose
from orbitfb.loco.schema import ResponseDiagnosis, document
from orbitfb.physics.places import Ring
from tests.unit.loco.synthetic_responses import NOISE, devices, synthetic


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
    assert "the whole response is off by" in headline


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


@pytest.mark.nightly
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


@pytest.mark.nightly
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
        (lambda m: 1e3 * m, r"e\+03 times as large.*--unit"),
        (lambda m: 1e-3 * m, r"0\.00\d+ times as large"),
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


def test_a_turned_bpm_is_one_finding_and_its_rows_are_no_outliers() -> None:
    truth = synthetic(11)
    own, rng, angle = truth.measured.response, np.random.default_rng(2), 0.1
    turned = np.zeros(len(own["x", "x"]))
    turned[20] = angle
    cross = {
        ("x", "y"): turned[:, None] * own["y", "y"],
        ("y", "x"): -turned[:, None] * own["x", "x"],
    }
    noisy = {pair: its + NOISE * rng.standard_normal(its.shape) for pair, its in cross.items()}
    unknown = {pair: np.full_like(its, np.nan) for pair, its in cross.items()}
    measured = replace(
        truth.measured, response={**own, **noisy}, sigma={**truth.measured.sigma, **unknown}
    )
    found = diagnose(truth.ring, measured)
    name = truth.ring.table.name[measured.bpms["x"][20]]
    assert [(its.kind, its.places) for its in found.named] == [("bpm-roll", (name,))]
    assert found.named[0].value == pytest.approx(angle, abs=0.005)
    assert found.coupling is not None
    assert not any(its.outliers.any() for its in found.coupling.noise.values())
    effects = fragment(answer_of(found, "m", (), ()).findings, found, "")
    assert effects.count("[[effect]]") == 1
    assert float(effects.split('"angle" = ')[1].split()[0]) == pytest.approx(angle, abs=0.005)


@pytest.mark.nightly
def test_a_measured_dispersion_is_fitted_with_the_matrix() -> None:
    truth = synthetic(12, gradients=0.003)
    noise, rng = 1e-4, np.random.default_rng(3)
    optics = RingOptics(truth.ring, truth.measured)
    own = optics.at(truth.gradient)["x"].dispersion
    read = truth.gain["x"] * own + noise * rng.standard_normal(len(own))
    read[4] = np.nan
    factor = 1.07  # the step of the RF is known as badly as this
    measured = replace(truth.measured, dispersion=factor * read)
    found = diagnose(truth.ring, measured)
    assert found.named == ()
    assert found.fit.converged
    gain, fitted = 1 + found.fit.part("gain:x"), found.fit.optics["x"].dispersion
    left = measured.dispersion - (1 + found.fit.part("rf")) * gain * fitted
    assert np.nanstd(left) < 1.3 * noise * factor
    before = measured.dispersion - factor * truth.ring.table.dispersion[measured.bpms["x"]]
    assert np.nanstd(before) > 10 * noise


@pytest.mark.nightly
def test_many_that_are_off_by_the_same_are_one_family() -> None:
    family, single = (3, 9, 14, 22, 31, 40), 27
    truth = synthetic(13, gains=0.01, faults={("gain", "x", k): 1.12 for k in family})
    own = truth.measured.response["x", "x"]
    own[single] *= 0.6
    found = diagnose(truth.ring, truth.measured)
    bpm = [f"{truth.ring.table.name[i]}:x" for i in truth.measured.bpms["x"]]
    told = {its.places: its for its in found.named if its.stands_out}
    assert set(told) == {tuple(bpm[k] for k in family), (bpm[single],)}
    its = told[tuple(bpm[k] for k in family)]
    assert its.value == pytest.approx(0.12, abs=0.01)
    assert "6 BPMs read 1.13 times what the others do" in its.text
    effects = fragment(answer_of(found, "m", (), ()).findings, found, "")
    assert effects.count("[[effect]]") == 2


@pytest.mark.nightly
def test_three_that_are_off_are_three_findings() -> None:
    truth = synthetic(14, gains=0.01, faults={("kick", "y", k): 1.12 for k in (3, 9, 14)})
    found = diagnose(truth.ring, truth.measured)
    assert [len(its.places) for its in found.named] == [1, 1, 1]


@pytest.mark.nightly
def test_a_row_that_shows_something_else_is_a_dead_bpm() -> None:
    truth = synthetic(15)
    own = truth.measured.response["x", "x"]
    own[6] = 0.12 * np.random.default_rng(4).permutation(own[40])
    found = diagnose(truth.ring, truth.measured)
    place = f"{truth.ring.table.name[truth.measured.bpms['x'][6]]}:x"
    told = [its.kind for its in found.named if its.places == (place,)]
    assert told == ["bpm-dead"]


@pytest.mark.nightly
def test_a_noise_that_is_stated_far_too_large_is_not_believed_and_told() -> None:
    truth = synthetic(16, known=True)
    stated = {pair: 10 * its for pair, its in truth.measured.sigma.items()}
    found = diagnose(truth.ring, replace(truth.measured, sigma=stated))
    for plane in "xy":
        assert np.std(found.fit.residual[plane]) < 1.1 * NOISE
        assert np.median(found.fit.noise[plane].sigma) == pytest.approx(NOISE, rel=0.2)
    notes = answer_of(found, "m", (), ()).notes
    assert [note.split(":")[0] for note in notes] == ["plane x", "plane y"]
    assert answer_of(diagnose(truth.ring, truth.measured), "m", (), ()).notes == ()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda m: np.where(np.arange(m.shape[1]) == 3, m, np.nan), "45 BPMs by 1 correctors"),
        (lambda m: 1e200 * m, r"e\+200 times as large"),
        (lambda m: np.full_like(m, np.nan), "0 BPMs by 0 correctors"),
    ],
)
def test_what_cannot_be_fitted_is_refused_before(change, told: str) -> None:
    truth = synthetic(10)
    response = dict(truth.measured.response)
    response["x", "x"] = change(response["x", "x"])
    with pytest.raises(RingError, match=told):
        diagnose(truth.ring, replace(truth.measured, response=response))


@pytest.mark.nightly
def test_a_table_off_by_0_03_in_tune_and_2_percent_in_quadrupoles_is_reached() -> None:
    ring, rng = Ring.load(), np.random.default_rng(33)
    empty = devices(ring, 3)
    optics = RingOptics(ring, empty)
    relative = np.zeros(len(optics.quadrupoles))
    wrong = rng.choice(len(relative), 10, replace=False)
    relative[wrong] = 0.02 * rng.choice((-1, 1), 10)
    families = (optics.strength > 0).astype(float), (optics.strength <= 0).astype(float)

    def off(errors: np.ndarray) -> np.ndarray:
        return np.array([optics.tune(p, errors) - ring.tune(p) for p in "xy"])

    for _ in range(10):
        slope = np.array([(off(relative + 1e-4 * its) - off(relative)) / 1e-4 for its in families])
        step = np.linalg.solve(slope.T, 0.03 - off(relative))
        relative = relative + step[0] * families[0] + step[1] * families[1]
    assert off(relative) == pytest.approx([0.03, 0.03], abs=1e-6)
    its = optics.at(relative)
    response = {
        (p, p): its[p].own + NOISE * rng.standard_normal(its[p].own.shape) for p in ("x", "y")
    }
    unknown = {pair: np.full_like(matrix, np.nan) for pair, matrix in response.items()}
    found = diagnose(ring, Measured(empty.bpms, empty.correctors, response, unknown))
    assert found.fit.converged
    assert off(found.fit.part("gradient")) == pytest.approx([0.03, 0.03], abs=2e-4)
    for plane in "xy":
        assert np.std(found.fit.residual[plane]) < 1.1 * NOISE
    assert {its.places[0] for its in found.named} <= {ring.names("QUAD")[i] for i in wrong}

"""What is told of a cause: where it acts, how far the gap shrinks, values, loop and limits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from orbitfb.core.errors import EstimationError
from orbitfb.diagnose.hypotheses.row_sums import moving_root
from orbitfb.diagnose.impact import one_step
from orbitfb.diagnose.impact.closed_loop import law_of, replayed
from orbitfb.diagnose.impact.innovations import at_bpms, errors_ahead, floor_of, whitened
from orbitfb.diagnose.impact.one_step import OneStep
from orbitfb.diagnose.impact.windows import Windows, quiet_level
from orbitfb.diagnose.report.writing import effects_of
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.verdict.engine import diagnose
from orbitfb.effects.registry import all_effects
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.transform import StepTransform
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import make_record


def answer(record: Record, later: Record | None = None) -> Diagnosis:
    return diagnose(record, None, later, seed=0, progress=lambda what, share: None)


def test_no_gap_is_resolved_where_the_causes_take_nothing_off_the_error() -> None:
    """It was told to shrink by all of 1e-138 pm."""
    errors = np.random.default_rng(5).standard_normal((300, 8))
    step = OneStep(
        (errors, errors),
        errors,
        errors,
        np.full(8, 1.1 * np.mean(errors**2)),
        Windows.of(len(errors)),
    )
    told = one_step.shrink(step, "the record itself", 1.0, 0.0)
    assert not told.resolved
    assert (told.before_um, told.after_um, told.um) == (0.0, 0.0, 0.0)
    double = replace(step, nominal=2.0 * errors)
    assert one_step.shrink(double, "the record itself", 1.0, 0.0).resolved


def clipped(currents: Matrix) -> Matrix:
    """Correctors 2 and 7 end at limits of their own."""
    kicked = currents[-1:].copy()
    kicked[:, 2] = np.clip(kicked[:, 2], -0.03, 0.03)
    kicked[:, 7] = np.clip(kicked[:, 7], -0.05, 0.05)
    return kicked


@pytest.fixture(scope="module")
def whole() -> Record:
    return make_record(24, currents=clipped)


@pytest.fixture(scope="module")
def told(whole: Record) -> Diagnosis:
    return answer(whole.rows(0, 600), whole.rows(600, 900))


def test_the_parts_of_the_gap_add_up(told: Diagnosis) -> None:
    gap = told.gap
    assert gap is not None
    whole = gap.nats_per_tick or 0.0
    assert whole > 0.0
    assert (gap.low or 0.0) < whole < (gap.high or 0.0)
    for parts in (
        list(gap.by_stage.values()),
        list(gap.by_bpm.values()),
        list(gap.by_mode),
        [piece.nats_per_tick for piece in gap.by_band],
        [piece.nats_per_tick for piece in gap.by_window],
    ):
        assert sum(part or 0.0 for part in parts) == pytest.approx(whole, rel=1e-5)
    assert told.waterfall[0].left_nats == pytest.approx(whole)
    assert told.waterfall[-1].left_nats == pytest.approx(0.0, abs=1e-6)


def test_every_device_has_its_own_value_and_the_simulator_gets_them(told: Diagnosis) -> None:
    made = {one.names: one.values["limit"] for one in effects_of(told.causes)}
    assert made[("C2",)] == pytest.approx(0.03, rel=0.07)  # its 90 % interval is 9 % wide
    assert made[("C7",)] == pytest.approx(0.05, rel=0.05)


def test_the_shrink_is_told_on_the_later_record_and_the_record_itself_says_the_same(
    whole: Record, told: Diagnosis
) -> None:
    itself = answer(whole.rows(0, 600))
    assert told.shrink is not None
    assert itself.shrink is not None
    assert (told.shrink.on, itself.shrink.on) == ("the later record", "the record itself")
    for shrink in (told.shrink, itself.shrink):
        assert (shrink.um or 0.0) > 0.85
        assert (shrink.um_high or 0.0) > 0.97  # all of it is explained


@pytest.mark.nightly
def test_what_the_floor_has_swallowed_is_not_said_to_be_gone() -> None:
    """From row 600 on corrector 9 wanders, and no effect that could be it is tested."""
    walk = 0.025 * np.random.default_rng(8).standard_normal(901)
    walk[:600] = 0.0
    walk = np.cumsum(walk)

    def wandering(currents: Matrix) -> Matrix:
        kicked = clipped(currents)
        kicked[0, 9] += walk[len(currents) - 1]
        return kicked

    others = {kind.id for kind in all_effects().values() if kind.stage in ("disturbance", "noise")}
    found = diagnose(
        make_record(24, currents=wandering), seed=0, progress=lambda what, share: None,
        without=frozenset(others),
    )  # fmt: skip
    assert "corrector-saturation" in {one.effect for one in found.causes}
    assert found.shrink is not None
    assert (found.shrink.um or 0.0) < 0.7


def test_predictions_further_ahead_are_worse_and_the_causes_bring_them_to_the_floor(
    told: Diagnosis,
) -> None:
    assert [step.k for step in told.k_steps] == [1, 2, 5, 10, 20]
    for step in told.k_steps:
        assert (step.nominal_um or 0.0) > (step.effect_um or 0.0)
        assert step.effect_um == pytest.approx(step.floor_um, rel=0.06)


def test_the_loop_that_is_run_again_with_the_causes_is_the_one_that_was_measured(
    told: Diagnosis,
) -> None:
    """The requested changes hold the dither, which the record does not tell: no law is known."""
    assert told.closed_loop is not None
    assert told.closed_loop.without_um is None
    assert "linear law" in told.closed_loop.note


def test_the_loop_is_run_where_its_law_is_known(whole: Record) -> None:
    response = whole.layout.response
    law = 0.4 * np.linalg.pinv(response)
    dither = np.vstack([np.diff(whole.setpoints, axis=0), np.zeros((1, 12))])
    dither[:-1] += whole.readings[:-1] @ law.T
    record = replace(whole, dither=dither)
    found, follows = law_of(record)
    assert follows > 0.999
    assert found == pytest.approx(law, abs=1e-3 * np.abs(law).max())
    moved = record.readings - record.setpoints @ response.T
    again = replayed(record, law, (moved,))[0]
    assert again == pytest.approx(record.readings, abs=1e-9)


def test_what_is_left_is_noise(told: Diagnosis) -> None:
    assert told.audit is not None
    assert not any(test.flagged for test in told.audit.tests), told.audit.tests


@pytest.mark.nightly
def test_a_size_that_the_record_would_have_shown_is_one_that_it_shows(told: Diagnosis) -> None:
    sizes = {one.effect: one for one in told.detectable}
    gain = sizes["corrector-gain"]
    assert 0.001 < (gain.best or 0.0) <= (gain.size or 0.0) < 0.3
    strong = 2.0 * (gain.size or 0.0)

    def stronger(currents: Matrix) -> Matrix:
        kicked = currents[-1:].copy()
        kicked[:, 4] *= 1.0 + strong
        return kicked

    first = answer(make_record(25, currents=stronger)).causes[0]
    assert first.effect == "corrector-gain"
    assert first.places == ("C4",)
    value = first.parameters["gain"]
    assert value.low is not None
    assert value.value == pytest.approx(strong, abs=2.0 * ((value.value or 0.0) - value.low))


@pytest.mark.parametrize("kind", ["short", "equal", "rank one"])
def test_a_record_without_a_floor_is_refused_with_what_would_help(whole: Record, kind: str) -> None:
    record = whole
    if kind == "short":
        record = whole.rows(0, 30)
    elif kind == "equal":
        record = replace(whole, readings=np.full_like(whole.readings, 1e-6),
                         setpoints=np.zeros_like(whole.setpoints))  # fmt: skip
    else:
        course = np.random.default_rng(0).standard_normal((len(whole), 1))
        record = replace(whole, readings=1e-6 * course @ np.ones((1, 16)),
                         setpoints=np.zeros_like(whole.setpoints))  # fmt: skip
    with pytest.raises(EstimationError, match="give"):
        answer(record)


def test_innovations_are_those_of_an_exact_filter() -> None:
    rng = np.random.default_rng(5)
    count, rows = 3, 60
    mixing = rng.standard_normal((count, count))
    noise = StepNoise(mixing @ mixing.T * 0.2, np.diag([1.0, 0.5, 2.0]))
    transform = StepTransform.of(np.arange(rows) == 0, exact=True)
    steps = rng.standard_normal((rows - 1, count))
    white = whitened(transform.turn(steps), noise, transform)
    size = (rows - 1) * count
    near = np.eye(rows - 1, k=1) + np.eye(rows - 1, k=-1)
    covariance = np.kron(np.eye(rows - 1), noise.walk + 2.0 * noise.white)
    covariance -= np.kron(near, noise.white)
    half = float(steps.ravel() @ np.linalg.solve(covariance, steps.ravel()))
    assert float(np.sum(white**2)) == pytest.approx(half, rel=1e-9)
    assert white.size == size


def test_errors_further_ahead_are_those_of_the_state() -> None:
    """A walk of one mode, filtered by hand with the steady gain."""
    rng = np.random.default_rng(6)
    ratio, rows = 0.3, 400
    noise = StepNoise(np.array([[ratio]]), np.array([[1.0]]))
    walk = np.cumsum(np.sqrt(ratio) * rng.standard_normal(rows))
    readings = (walk + rng.standard_normal(rows))[:, None]
    transform = StepTransform.of(np.arange(rows) == 0, exact=True)
    spectrum = transform.spectrum(readings)
    white = whitened(spectrum, noise, transform)
    gain = 1.0 - float(moving_root(noise.ratio)[0])
    state, wanted = float(readings[0, 0]), []
    states = [state]
    for row in range(1, rows):
        state += gain * (readings[row, 0] - state)
        states.append(state)
    wanted = [readings[row, 0] - states[row - 5] for row in range(5, rows)]
    found = errors_ahead(white, noise, transform, 5)[:, 0]
    assert found[100:] == pytest.approx(np.array(wanted)[-len(found) :][100:], abs=1e-6)
    assert float(floor_of(noise, 5)[0]) == pytest.approx(1.0 / (1.0 - gain) + 4 * ratio)


@pytest.mark.parametrize("kept", [0.5, 0.3])
def test_innovations_of_a_ground_that_goes_on_are_white(kept: float) -> None:
    """Steps Δ_n = φ Δ_(n−1) + e_n: one row ahead e_n is left, two ahead (1 + φ) e_n besides."""
    rng = np.random.default_rng(8)
    drawn = rng.standard_normal((8000, 3))
    steps = lfilter([1.0], [1.0, -kept], drawn, axis=0)
    transform = StepTransform.of(np.arange(len(steps) + 1) == 0, 16)
    spectrum = transform.turn(steps)
    noise = StepNoise(np.eye(3) / (1.0 - kept**2), 1e-6 * np.eye(3))
    level, noise = noise.recoloured(spectrum, transform)
    noise = replace(noise, walk=level[0] * noise.walk)
    white = whitened(spectrum, noise, transform)
    near = np.mean(white[1:] * white[:-1]), np.mean(white[2:] * white[:-2])
    assert np.abs(near).max() < 0.06  # the walk's own filter leaves φ
    assert float(np.mean(white**2)) == pytest.approx(1.0, abs=0.05)
    assert at_bpms(white, noise) == pytest.approx(drawn, abs=0.6)
    np.testing.assert_allclose(floor_of(noise), 1.0, rtol=0.05)
    np.testing.assert_allclose(floor_of(noise, 2), 1.0 + (1.0 + kept) ** 2, rtol=0.08)
    far = errors_ahead(white, noise, transform, 2)
    np.testing.assert_allclose(np.mean(far**2, axis=0), floor_of(noise, 2), rtol=0.06)


def test_the_quiet_windows_tell_the_level_where_something_begins_late() -> None:
    errors = np.random.default_rng(7).standard_normal((1200, 20))
    windows = Windows.of(1200)
    assert quiet_level(errors, 20.0, windows) == 1.0
    errors[800:, 3] *= 5.0  # in one direction only
    assert quiet_level(errors, 12.0, windows) == pytest.approx(1.0 / np.mean(errors**2), rel=0.04)

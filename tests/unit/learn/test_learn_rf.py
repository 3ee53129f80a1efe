"""The learner and the RF: what a candidate knows of it, what is predicted, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.transitions import Transitions
from orbitfb.estimation.columns import KnownRf
from orbitfb.learn.forecast import predict_loop
from orbitfb.learn.learner import Learner
from orbitfb.learn.messages import pack, unpack
from orbitfb.learn.rf_steps import rf_steps
from orbitfb.learn.settings import LearnSettings
from orbitfb.models.linear import LinearModel
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.rf_known import rf_of, told, with_rf
from orbitfb.policies.svd import SvdPolicy, SvdSettings

N, M, ROWS, NOISE, STEP = 12, 10, 1500, 0.2e-6, 0.04e-6
RESPONSE = 1e-3 * np.random.default_rng(0).standard_normal((N, M)) + 3e-3 * np.eye(N, M)
TOLD = KnownRf(
    1e-6 * (1.0 + 0.3 * np.random.default_rng(1).standard_normal(N)),
    50.0 * np.random.default_rng(2).standard_normal(M),
)


def recorded(size: float, incumbent, seed=3) -> Transitions:
    """A closed loop whose frequency goes up and down; a step does `size` times what is told."""
    rng = np.random.default_rng(seed)
    orbit, setpoints = np.zeros(N), np.zeros(M)
    orbits, changes, hertz, before = [], [], [], []
    for tick in range(ROWS + 1):
        reading = orbit + NOISE * rng.standard_normal(N)
        change = -incumbent.gain_matrix @ reading
        step = (1.0, 0.0, 0.0, -1.0, 0.0, 0.0)[tick % 6]
        orbits.append(reading)
        changes.append(change)
        hertz.append(step)
        before.append(setpoints)
        setpoints = setpoints + change
        orbit = orbit + RESPONSE @ change + step * size * TOLD.response
        orbit = orbit + STEP * rng.standard_normal(N)
    time, yes = 0.1 * np.arange(ROWS + 1), np.ones(ROWS, dtype=bool)
    orbits, changes, before = (np.array(its) for its in (orbits, changes, before))
    return Transitions(
        tick=np.arange(ROWS),
        time=time[:-1],
        next_time=time[1:],
        written=time[:-1],
        orbit=orbits[:-1],
        next_orbit=orbits[1:],
        reference=np.zeros((ROWS, N)),
        valid=np.ones((ROWS, N), dtype=bool),
        requested=changes[:-1],
        applied=changes[:-1],
        dither=np.zeros((ROWS, M)),
        setpoints=before[:-1],
        readback=before[:-1],
        policy_id=np.full(ROWS, incumbent.policy_id),
        closed=yes,
        hertz=np.array(hertz[:-1]),
        usable=yes,
        auxiliary={},
    )


def refit(size: float, known: KnownRf | None = TOLD, of_incumbent: KnownRf | None = None):
    incumbent = with_rf(SvdPolicy(1.3 * RESPONSE, SvdSettings()), of_incumbent)
    settings = LearnSettings.model_validate({"identify": {"prior_relative": 0.3}})
    learner = Learner(
        1.3 * RESPONSE,
        settings,
        lambda model, _: MaskedPolicy(
            SvdPolicy(model.response, SvdSettings()), model.response, np.ones(M, dtype=bool)
        ),
        ManualClock(),
        rf=known,
    )
    return learner.refit(recorded(size, incumbent), incumbent, "on-demand")


def test_a_candidate_brings_the_column_that_was_identified_with_its_response():
    report, candidate = refit(1.1)
    figures = report.figures
    assert figures["rf_ratio_low"] < 1.1 < figures["rf_ratio_high"]
    assert figures["rf_ratio_low"] > 1.0 and figures["rf_steps"] == pytest.approx(ROWS / 3, abs=2)
    assert f"RF column {figures['rf_ratio']:.3f} [" in report.reason
    found = rf_of(candidate)
    assert found.identified and found.energy is TOLD.energy
    np.testing.assert_allclose(found.response, 1.1 * TOLD.response, rtol=0.1)
    travelled = rf_of(unpack(pack(candidate)))
    np.testing.assert_array_equal(travelled.response, found.response)
    assert travelled.identified


@pytest.mark.parametrize(
    ("size", "words"), [(-1.0, "of the wrong sign"), (0.2, "far too small"), (2.5, "far too large")]
)
def test_a_column_that_cannot_be_is_not_taken_and_the_refit_says_so(size, words):
    report, candidate = refit(size)
    assert "the RF column that was identified is not taken" in report.reason
    assert words in report.reason
    assert rf_of(candidate) is TOLD
    before = replace(TOLD, response=0.9 * TOLD.response)
    assert rf_of(refit(size, of_incumbent=before)[1]) is before


def test_where_the_loop_leaves_the_rf_alone_there_is_nothing_of_it():
    report, candidate = refit(1.1, None)
    assert not any(name.startswith("rf_") for name in report.figures)
    assert "RF" not in report.reason and rf_of(candidate) is None
    assert report.figures["rows_left_out"] == pytest.approx(ROWS / 3, abs=2)


def test_rows_speak_against_a_column_that_is_wrong():
    """The evidence compares responses with their columns, not responses alone."""
    right = replace(TOLD, response=1.1 * TOLD.response)
    against = refit(1.1)[0].figures["evidence"]
    assert against > refit(1.1, of_incumbent=right)[0].figures["evidence"] + 10.0


def linear(rf=None) -> LinearModel:
    return LinearModel(
        response=RESPONSE,
        modes=np.eye(N),
        levels=np.zeros(N, dtype=np.intp),
        covariances=1e-18 * np.eye(M)[None],
        reading_variance=NOISE**2,
        ground_variances=np.full(N, STEP**2),
        creep=np.zeros(N),
        rf=rf,
    )


def test_what_steps_leave_is_predicted_as_a_simulation_has_it():
    rng = np.random.default_rng(5)
    gain, ticks, many = SvdPolicy(RESPONSE, SvdSettings()).gain_matrix, 256, 3000
    kick = 0.3e-6 * rng.standard_normal(N)
    orbit = np.zeros((many, N))
    for _ in range(ticks):
        reading = orbit + NOISE * rng.standard_normal(orbit.shape)
        left = rng.standard_normal((many, 1)) * kick
        ground = STEP * rng.standard_normal(orbit.shape)
        orbit = orbit - reading @ gain.T @ RESPONSE.T + left + ground
    found = predict_loop(gain, [RESPONSE], linear(), ticks, kick)
    assert found.rms == pytest.approx(np.sqrt(np.mean(orbit**2)), rel=0.03)
    assert found.rms > 1.2 * predict_loop(gain, [RESPONSE], linear(), ticks).rms


def test_the_judge_sees_what_each_law_leaves_of_a_step():
    identified = refit(1.1)
    learnt = rf_of(identified[1])
    square, generator = 0.5, np.random.default_rng(6)
    right = with_rf(SvdPolicy(RESPONSE, SvdSettings()), learnt)
    wrong = SvdPolicy(1.2 * RESPONSE, SvdSettings())
    column = Column(learnt)
    steps = rf_steps(column, right, wrong, square)
    ours, theirs = steps.kicks(np.zeros((N, M)), RESPONSE, np.eye(N), generator)
    assert np.linalg.norm(ours) < 0.8 * np.linalg.norm(theirs)
    assert rf_steps(None, right, wrong, square) is None
    assert rf_steps(column, right, wrong, 0.0) is None


class Column:
    """A column that is known exactly."""

    def __init__(self, rf):
        self.told, self.response = TOLD, rf.response

    def drawn_with(self, *_):
        return self.response


def test_a_policy_is_told_the_table_unless_it_knows_better():
    learnt = replace(TOLD, identified=True)
    policy = SvdPolicy(RESPONSE, SvdSettings())
    assert rf_of(told(policy, None)) is None
    assert rf_of(told(policy, TOLD)) is TOLD
    assert rf_of(told(with_rf(policy, learnt), TOLD)) is learnt

"""One refit on records of the simulated ring: promoted, refused, impossible."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import EstimationError
from orbitfb.core.refit import Decision
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.learner import Learner
from orbitfb.learn.settings import LearnSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()


def law(response):
    return SvdPolicy(response, SvdSettings())


def build(model, incumbent):
    return SvdPolicy(model.response, SvdSettings(), covariance=model.row_covariance)


def learner_from(response, **settings):
    return Learner(response, LearnSettings(**settings), build, ManualClock())


@pytest.fixture(scope="module")
def truth():
    return Plant(RING, seed=1).response


@pytest.fixture(scope="module")
def right(truth):
    return ClosedLoop(Plant(RING, seed=1), law(truth), 400).run()


@pytest.fixture(scope="module")
def wrong(truth):
    """A loop whose response is far too small, so that it overshoots."""
    return ClosedLoop(Plant(RING, seed=1), law(0.4 * truth), 400).run()


def test_the_right_law_is_not_replaced_by_a_worse_one(truth, right):
    learner = learner_from(truth)
    report, candidate = learner.refit(right.transitions(), right.policy, "on-demand")
    assert candidate is not None
    assert report.decision is Decision.REFUSED
    assert report.figures["response_moved"] < 0.02
    assert (report.number, report.rows, report.incumbent_id) == (1, 398, right.policy.policy_id)


def test_a_wrong_law_is_replaced(truth, wrong):
    learner = learner_from(0.4 * truth, identify={"prior_relative": 1.0})
    report, candidate = learner.refit(wrong.transitions(), wrong.policy, "periodic")
    assert report.decision is Decision.ACCEPTED
    assert candidate is not None and report.policy_id == candidate.policy_id
    assert report.figures["chi2_incumbent"] > 1.0


class Pupil:
    """A policy that learns by itself."""

    learns = True

    def __init__(self, policy, chi2=2.0):
        self.response, self.gain_matrix = policy.response, policy.gain_matrix
        self.policy_id, self.chi2 = "pupil", chi2


def test_a_policy_that_learns_is_replaced_only_when_rows_refute_what_it_knows(truth, right, wrong):
    learner = learner_from(truth)
    report, candidate = learner.refit(right.transitions(), Pupil(law(truth)), "on-demand")
    assert report.decision is Decision.REFUSED and candidate is None
    assert "pupil learns by itself" in report.reason
    learner = learner_from(0.4 * truth, identify={"prior_relative": 1.0})
    report, candidate = learner.refit(wrong.transitions(), Pupil(wrong.policy), "periodic")
    assert report.decision is Decision.ACCEPTED and candidate is not None


def test_a_policy_that_learns_stays_while_it_explains_what_it_reads(truth, wrong):
    """Rows say much against its R̂ alone where it doubts R̂ as much as they say."""
    learner = learner_from(0.4 * truth, identify={"prior_relative": 1.0})
    report, candidate = learner.refit(wrong.transitions(), Pupil(wrong.policy, 1.1), "periodic")
    assert report.decision is Decision.REFUSED and candidate is None
    assert "its own χ² 1.1, limit 1.3" in report.reason


def test_rows_teach_once(truth, right):
    learner = learner_from(truth)
    learner.refit(right.transitions(), right.policy, "periodic")
    before = learner.model.response
    assert learner.absorb(right.transitions(), right.policy).rows == 0
    assert np.array_equal(before, learner.model.response)


def test_nothing_written_is_refused_as_no_excitation(truth, right):
    rows = right.transitions(300)
    still = replace(
        rows,
        applied=np.zeros_like(rows.applied),
        setpoints=np.zeros_like(rows.setpoints),
        readback=np.zeros_like(rows.readback),
    )
    report, candidate = learner_from(truth).refit(still, right.policy, "periodic")
    assert report.decision is Decision.REFUSED
    assert "no excitation" in report.reason
    assert candidate is None and report.policy_id == right.policy.policy_id


def test_too_few_rows_are_refused(truth, right):
    report, candidate = learner_from(truth).refit(right.transitions(380), right.policy, "periodic")
    assert report.decision is Decision.REFUSED and candidate is None
    assert "only 18 rows" in report.reason


def test_rows_that_cannot_be_used_at_all_are_an_error(truth, right):
    rows = right.transitions(300)
    bad = replace(rows, usable=np.zeros(len(rows), dtype=bool))
    with pytest.raises(EstimationError, match="99 unusable"):
        learner_from(truth).refit(bad, right.policy, "on-demand")


def test_poisoned_rows_do_not_move_the_estimate(truth, right):
    rows = right.transitions()
    poisoned = replace(rows, next_orbit=rows.next_orbit.copy(), readback=rows.readback.copy())
    poisoned.next_orbit[200] = 1.0
    poisoned.readback[200] += 10.0
    clean, wary = learner_from(truth), learner_from(truth)
    clean.refit(rows, right.policy, "on-demand")
    report, _ = wary.refit(poisoned, right.policy, "on-demand")
    assert report.figures["rows_left_out"] == 1
    moved = np.linalg.norm(clean.model.response - wary.model.response)
    assert moved < 1e-3 * np.linalg.norm(truth)

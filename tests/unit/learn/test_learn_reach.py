"""What of an orbit error no corrector reaches is told beside what a law makes of noise."""

from dataclasses import replace

import numpy as np
import pytest
from test_learn_judge import GOOD, RESPONSE, Proportional, model

from orbitfb.core.clock import ManualClock
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.judge import Evidence, judge
from orbitfb.learn.learner import Learner
from orbitfb.learn.reach import mean_error, unreachable_rms
from orbitfb.learn.settings import JudgeSettings, LearnSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def test_it_is_what_is_left_of_the_error_by_least_squares():
    generator = np.random.default_rng(1)
    response, error = generator.standard_normal((9, 4)), generator.standard_normal(9)
    moving = np.array([True, True, False, True])
    seen, free = error.copy(), response[:, moving]
    left = error - free @ np.linalg.lstsq(free, error, rcond=None)[0]
    assert unreachable_rms(seen, response, moving) == pytest.approx(np.sqrt(np.mean(left**2)))
    seen[2] = np.nan
    some = np.isfinite(seen)
    left = error[some] - free[some] @ np.linalg.lstsq(free[some], error[some], rcond=None)[0]
    assert unreachable_rms(seen, response, moving) == pytest.approx(np.sqrt(np.mean(left**2)))
    assert unreachable_rms(error, response, np.zeros(4, dtype=bool)) == pytest.approx(
        np.sqrt(np.mean(error**2))
    )
    assert unreachable_rms(np.full(9, np.nan), response, moving) == 0.0


def test_the_verdict_tells_both():
    def told(unreachable):
        return judge(
            Proportional(GOOD), Proportional(0.2 * GOOD), model(RESPONSE), Evidence(0.0, 0.0),
            JudgeSettings(), np.random.default_rng(1), 0.0, unreachable,
        )  # fmt: skip

    verdict = told(0.84e-6)
    assert "and 0.8400 µm rms that the correctors cannot reach" in verdict.reason
    assert verdict.figures["unreachable_rms"] == 0.84e-6
    assert "cannot reach" not in told(1e-9).reason


def test_a_refit_tells_it_of_the_ring():
    """Half of the correctors are masked: what the others cannot reach stays."""
    ring = Ring.load()
    plant = Plant(ring, seed=1)
    truth, mask = plant.response, np.arange(180) % 2 == 0
    policy = MaskedPolicy(SvdPolicy(truth, SvdSettings()), truth, mask)
    record = ClosedLoop(plant, policy, 300).run()

    def build(model, incumbent):
        return MaskedPolicy(SvdPolicy(model.response, SvdSettings()), model.response, mask)

    learner = Learner(truth, LearnSettings(), build, ManualClock())
    report, _ = learner.refit(record.transitions(), policy, "on-demand")
    error = mean_error(record.transitions())
    assert error is not None
    assert report.figures["unreachable_rms"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=0.2)
    assert report.figures["unreachable_rms"] > 3 * report.figures["predicted_rms_candidate"]


def test_rows_of_an_open_loop_say_nothing():
    record = ClosedLoop(Plant(Ring.load(), seed=1), SvdPolicy(Plant(Ring.load()).response,
                                                              SvdSettings()), 10).run()  # fmt: skip
    rows = record.transitions()
    assert mean_error(replace(rows, closed=np.zeros_like(rows.closed))) is None

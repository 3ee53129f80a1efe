"""The learner in the real loop: laws side by side, each in a process, as one after the other."""

import json

import numpy as np
import pytest

from orbitfb.evaluate.live import LAWS, evaluate_live
from orbitfb.evaluate.live_report import LiveResult, write
from orbitfb.evaluate.live_settings import LiveSettings

pytestmark = [pytest.mark.system, pytest.mark.nightly]


def test_laws_side_by_side_do_what_they_do_alone(tmp_path):
    settings = LiveSettings(drift="paper", ticks=200, seed=3)
    settings = settings.model_copy(
        update={"policy": settings.policy.model_copy(update={"kind": "adaptive"})}
    )
    told = []
    [(_, alone)] = evaluate_live([settings], told.append)
    [(same, beside)] = evaluate_live([settings], told.append, at_once=3)
    assert same == settings and set(beside) == set(LAWS)
    assert told == [
        *(f"seed 3, paper drift: {law}" for law in LAWS),
        "seed 3, paper drift: told, frozen, ours",
    ]
    for law in LAWS:
        assert beside[law].state == "CLOSED", beside[law].reason
        np.testing.assert_allclose(
            beside[law].second_half(), alone[law].second_half(), rtol=0.05, err_msg=law
        )
    write([LiveResult(settings, beside)], tmp_path)
    assert json.loads((tmp_path / "live.json").read_text())[0]["rms_ratio_ours"] < 1.15

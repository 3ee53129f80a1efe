"""Another cut or another λ: predicted before it is applied."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orbitfb.app.commands.preview import Latest, Trial
from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Orbit, Reading
from orbitfb.loop.slot import PolicySlot
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

CHANNELS = Ring.load().channels("x")
RESPONSE = response(Ring.load(), "x")
N, M = RESPONSE.shape
ORBIT = 1e-4 * np.random.default_rng(3).standard_normal(N)
REFERENCE = 1e-5 * np.ones(N)


class Bench:
    def __init__(self, directory: Path) -> None:
        self.slot = PolicySlot(SvdPolicy(RESPONSE, SvdSettings(gain=0.5)))
        self.store = PolicyStore(directory)
        self.latest = Latest()
        self.asked: list[Any] = []
        self.trial = Trial(
            self.slot,
            self.store,
            CHANNELS,
            SvdSettings(),
            self.latest,
            lambda: np.ones(M, dtype=bool),
            lambda request: self.asked.append(request) or {"policy": request["policy"]},
        )

    def see(self) -> None:
        reading = Reading(Orbit(ORBIT, np.ones(N, dtype=bool), 0.0), np.zeros(M), {}, 0.0)
        self.latest(cast(Any, SimpleNamespace(reading=reading, reference=REFERENCE)))

    def __call__(self, command: str, **arguments: object) -> Any:
        return self.trial.handlers[command]({"command": command, **arguments})


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    bench = Bench(tmp_path)
    bench.see()
    return bench


def test_the_prediction_is_what_the_law_would_do(bench: Bench):
    answer = bench("try", singular_values=40, regularisation=0.0)
    u, s, v = np.linalg.svd(RESPONSE)
    error = ORBIT - REFERENCE
    change = -0.5 * v[:40].T @ (u[:, :40].T @ error / s[:40])
    after = error + RESPONSE @ change
    assert answer["largest_change_A"] == pytest.approx(np.abs(change).max())
    assert answer["rms_change_A"] == pytest.approx(np.sqrt(np.mean(change**2)))
    assert answer["orbit_rms_um"] == pytest.approx(np.sqrt(np.mean(after**2)) * 1e6)
    shown = bench.trial.shown()
    assert shown["PredictedMax-I"] == answer["largest_change_A"]
    assert (shown["Modes-RB"], shown["Lambda-RB"]) == (M, 70e-6)  # in force as before
    assert bench.asked == [] and list(bench.store.cards()) == []


def test_cut_and_lambda_add_up_until_they_are_applied(bench: Bench):
    bench("try", singular_values=40)
    both = bench("try", regularisation=1e-4)["policy"]
    answer = bench("apply")
    assert answer == {"policy": both}
    stored = bench.store.load(both, CHANNELS)
    assert isinstance(stored, SvdPolicy)
    settings = stored.settings
    assert (settings.singular_values, settings.regularisation, settings.gain) == (40, 1e-4, 0.5)
    assert bench.asked == [{"command": "activate", "policy": both, "force": False}]
    with pytest.raises(ControlError, match="nothing was tried yet"):
        bench("apply")


def test_nothing_is_applied_to_another_policy_than_it_was_tried_on(bench: Bench):
    bench("try", singular_values=40)
    bench.slot.swap(SvdPolicy(1.1 * RESPONSE, SvdSettings()))
    with pytest.raises(ControlError, match="has changed since the trial"):
        bench("apply")
    assert bench.asked == []


def test_without_an_orbit_nothing_is_predicted(tmp_path: Path):
    with pytest.raises(ControlError, match="no orbit has come yet"):
        Bench(tmp_path)("try", singular_values=40)


@pytest.mark.parametrize(
    "arguments",
    [
        {},
        {"singular_values": 0},
        {"singular_values": M + 1},
        {"singular_values": 2.0},
        {"singular_values": True},
        {"regularisation": -1e-6},
        {"regularisation": float("nan")},
        {"regularisation": 1.1},
        {"regularisation": "1"},
    ],
)
def test_what_cannot_be_tried(bench: Bench, arguments: dict[str, object]):
    with pytest.raises(ControlError):
        bench("try", **arguments)
    assert bench.trial.shown()["PredictedMax-I"] is None


def test_weights_are_tried_like_the_cut(bench: Bench):
    weights = [1.0] * N
    weights[7] = 5.0
    answer = bench("try", weights=weights)
    bench("apply")
    stored = cast(Any, bench.store.load(answer["policy"], CHANNELS))
    assert stored.settings.bpm_weights == tuple(weights)
    assert bench.trial.shown()["BpmWeight-RB"] == [1.0] * N  # the bench activates nothing
    bench.slot.swap(stored)
    assert bench.trial.shown()["BpmWeight-RB"] == weights


@pytest.mark.parametrize(
    "weights", [[1.0] * (N - 1), [0.0] * N, [-1.0] * N, [101.0] * N, [True] * N, ["1"] * N, 1.0]
)
def test_weights_that_make_no_sense_are_refused(bench: Bench, weights: object):
    with pytest.raises(ControlError, match="weights must be 180 numbers from 0 to 100"):
        bench("try", weights=weights)

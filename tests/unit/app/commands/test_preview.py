"""Another cut or another λ: predicted before it is applied."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, cast

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
    def __init__(self, directory: Path, planes: Literal["x", "xy"] = "x") -> None:
        matrix = response(Ring.load(), planes)
        self.channels = Ring.load().channels(planes)
        self.slot = PolicySlot(SvdPolicy(matrix, SvdSettings(gain=0.5)))
        self.store = PolicyStore(directory)
        self.latest = Latest()
        self.asked: list[Any] = []
        self.trial = Trial(
            self.slot,
            self.store,
            self.channels,
            SvdSettings(),
            self.latest,
            lambda: np.ones(matrix.shape[1], dtype=bool),
            lambda request: self.asked.append(request) or {"policy": request["policy"]},
        )

    def see(self) -> None:
        times = len(self.channels.planes)
        orbit, valid = np.tile(ORBIT, times), np.ones(times * N, dtype=bool)
        reading = Reading(Orbit(orbit, valid, 0.0), np.zeros(times * M), {}, 0.0)
        reference = np.tile(REFERENCE, times)
        self.latest(cast(Any, SimpleNamespace(reading=reading, reference=reference)))

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


def test_each_plane_has_a_cut_and_a_lambda_of_its_own(tmp_path: Path):
    bench = Bench(tmp_path, "xy")
    bench.see()
    shown = bench.trial.shown()
    assert (shown["Modes-RB"], shown["ModesX-RB"], shown["LambdaY-RB"]) == (2 * M, None, None)
    bench("try", plane="y", singular_values=40)
    bench("try", plane="x", regularisation=2e-4)
    answer = bench("try", plane="y", singular_values=30)  # takes the place of the 40
    stored = bench("apply")["policy"]
    assert stored == answer["policy"]
    policy = bench.store.load(stored, bench.channels)
    assert isinstance(policy, SvdPolicy)
    laws = policy.settings.planes
    assert (laws["x"].singular_values, laws["x"].regularisation) == (None, 2e-4)
    assert (laws["y"].singular_values, laws["y"].regularisation) == (30, None)
    bench.slot.swap(policy)
    shown = bench.trial.shown()
    assert shown["Modes-RB"] is None and shown["Lambda-RB"] is None
    assert (shown["ModesX-RB"], shown["ModesY-RB"]) == (M, 30)
    assert (shown["LambdaX-RB"], shown["LambdaY-RB"]) == (2e-4, 70e-6)
    whole = bench("try", singular_values=300)["policy"]  # without a plane: of the whole again
    bench("apply")
    whole = bench.store.load(whole, bench.channels)
    assert isinstance(whole, SvdPolicy)
    assert whole.settings.singular_values == 300 and not whole.settings.planes


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"plane": "z", "singular_values": 3}, "no plane 'z'"),
        ({"plane": "y", "singular_values": M + 1}, f"from 1 to {M}"),
        ({"plane": "y"}, "try takes singular_values, regularisation, weights"),
        ({"plane": "y", "weights": [1.0] * 2 * N}, "plane goes with"),
    ],
)
def test_what_makes_no_sense_of_a_plane_is_refused(
    tmp_path: Path, arguments: dict[str, object], told: str
):
    bench = Bench(tmp_path, "xy")
    bench.see()
    with pytest.raises(ControlError, match=told):
        bench("try", **arguments)
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

"""Training the structured law: what is trained moves, what is not stays, and it pays."""

import numpy as np
import pytest
import torch

from orbitfb.core.errors import ConfigError
from orbitfb.policies.embedding import embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings, kalman_gain
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.policies.training.rehearsal import Rehearsal, judge
from orbitfb.policies.training.structured import StructuredLaw, train_structured
from orbitfb.policies.training.trajectory_settings import StructuredSettings


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ring(n: int = 12, m: int = 12) -> np.ndarray:
    rng = np.random.default_rng(0)
    u = np.linalg.qr(rng.standard_normal((n, n)))[0]
    v = np.linalg.qr(rng.standard_normal((m, m)))[0]
    k = min(n, m)
    return (u[:, :k] * np.geomspace(3e-2, 1e-4, k)) @ v[:, :k].T


class Linear:
    def __init__(self, gain_matrix: np.ndarray) -> None:
        self.gain_matrix = gain_matrix

    def changes(self, errors: np.ndarray) -> np.ndarray:
        return -errors @ self.gain_matrix.T


@pytest.mark.parametrize("shape", [(12, 12), (14, 10), (10, 14)])
@pytest.mark.parametrize("doubt", [None, 2e-4])
def test_law_in_training_and_law_exported_act_alike(shape, doubt) -> None:
    response = ring(*shape)
    covariance = None if doubt is None else doubt**2 * np.diag(np.linspace(0.0, 1.0, shape[1]))
    # More correctors than BPMs leave directions that nothing but regularisation determines.
    settings = ModalSettings(regularisation=1e-5, near_caution=0.05)
    law = ModalPolicy(response, settings, gains=0.2, thresholds=1e-6, covariance=covariance)
    module = StructuredLaw(response, law, StructuredSettings())
    with torch.no_grad():
        for parameter in (module.far, module.floor, module.threshold):
            shift = torch.Generator().manual_seed(1)
            parameter += torch.randn(parameter.shape, generator=shift)
    for size in (1e-7, 1e-6, 1e-4):
        orbits = size * np.random.default_rng(0).standard_normal((5, shape[0]))
        inside = module(torch.from_numpy(orbits.astype(np.float32))).detach().numpy()
        outside = module.export().changes(orbits)
        np.testing.assert_allclose(inside, outside, atol=2e-4 * np.abs(outside).max())


@pytest.mark.parametrize("trained", [("far",), ("floor",), ("threshold",)])
def test_only_what_is_named_is_trained(trained: tuple[str, ...]) -> None:
    response = ring()
    start = ModalPolicy(response, ModalSettings(), gains=0.3, thresholds=5e-6)
    settings = StructuredSettings(trained=trained, iterations=5, horizon=3)
    law = train_structured(response, settings, start=start, device="cpu").policy
    changed = {
        "far": law.covariance is not None,
        "floor": not np.array_equal(law.gains, start.gains),
        "threshold": not np.array_equal(law.thresholds, start.thresholds),
    }
    assert changed == {name: name in trained for name in changed}


def test_linear_modes_stay_linear() -> None:
    response = ring()
    thresholds = np.full(12, 2e-6)
    thresholds[3], thresholds[4] = np.inf, 0.0
    start = ModalPolicy(response, ModalSettings(), gains=0.5, thresholds=thresholds)
    settings = StructuredSettings(trained=("floor", "threshold"), iterations=5, horizon=3)
    law = train_structured(response, settings, start=start, device="cpu").policy
    assert np.isinf(law.thresholds[3])
    assert law.thresholds[4] == 0.0
    assert law.gains[3] != 0.5


@pytest.mark.nightly
def test_an_uninformed_start_becomes_better_than_svd_in_a_second_or_two() -> None:
    response = ring()
    start = ModalPolicy(response, ModalSettings(), gains=0.5, thresholds=1e-4)
    result = train_structured(response, StructuredSettings(), start=start, device="cpu")
    rings = np.repeat(response[None], 16, axis=0)
    trial = Rehearsal(seed=5)
    best = min(
        judge(Linear(SvdPolicy(response, SvdSettings(gain=gain)).gain_matrix), rings, trial).score
        for gain in (0.1, 0.3, 0.5, 1.0)
    )
    reached = judge(result.policy, rings, trial)
    assert reached.score < best
    assert reached.floor < 0.75 * 0.2e-6
    assert result.figures["after_score"] < result.figures["before_score"]
    # And so does the network that it is written into.
    assert judge(embed(result.policy), rings, trial).score == pytest.approx(reached.score, abs=1e-3)


@pytest.mark.nightly
def test_gain_at_the_floor_is_found_to_be_that_of_the_kalman_filter() -> None:
    response = 1e-2 * np.eye(12)
    noise = motion = 1e-6
    start = ModalPolicy(response, ModalSettings(), gains=0.9, thresholds=np.inf)
    settings = StructuredSettings(
        trained=("floor",),
        loss="rms",
        amplitude=1e-6,
        smallest_amplitude=None,
        reading_noise=noise,
        kick_noise=motion,
        horizon=30,
        batch=64,
        learning_rate=5e-2,
        iterations=150,
    )
    law = train_structured(response, settings, start=start, device="cpu").policy
    # The best gain of the last orbit: a constant-gain filter of a random walk with q = r.
    assert np.mean(law.gains) == pytest.approx(kalman_gain(motion**2, noise**2), rel=0.06)


def test_resumed_and_refused(tmp_path) -> None:
    response = ring()
    settings = StructuredSettings(iterations=120, horizon=2, batch=4)
    whole = train_structured(response, settings, device="cpu")

    class PulledError(Exception):
        pass

    def pull(done: int, _loss: float) -> None:
        if done == 110:
            raise PulledError

    with pytest.raises(PulledError):
        train_structured(response, settings, device="cpu", progress=pull, checkpoint=tmp_path)
    resumed = train_structured(response, settings, device="cpu", checkpoint=tmp_path)
    assert resumed.policy.policy_id == whole.policy.policy_id
    with pytest.raises(ConfigError, match="same ring"):
        train_structured(ring(14, 10), settings, start=whole.policy, device="cpu")

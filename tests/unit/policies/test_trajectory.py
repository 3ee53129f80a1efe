"""Training through the system model: gradients, closed forms, what is held, what resumes."""

import numpy as np
import pytest
import torch

from orbitfb.core.errors import ConfigError, RingError, TrainingError
from orbitfb.policies.embedding import embed
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.training.coordinates import Coordinates
from orbitfb.policies.training.fine_tune import fine_tune
from orbitfb.policies.training.rehearsal import Rehearsal, judge, rehearse, spectral_radius
from orbitfb.policies.training.rollout import LinearResponses, TrajectoryLoss
from orbitfb.policies.training.trajectory import build, descend, train_trajectory
from orbitfb.policies.training.trajectory_settings import (
    FineTuneSettings,
    RolloutSettings,
    TrajectorySettings,
    stage,
)

CPU = torch.device("cpu")


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ring(n: int = 12, m: int = 12, seed: int = 0) -> np.ndarray:
    """Make a response matrix with a decade and a half between its modes [m/A]."""
    rng = np.random.default_rng(seed)
    u = np.linalg.qr(rng.standard_normal((n, n)))[0]
    v = np.linalg.qr(rng.standard_normal((m, m)))[0]
    k = min(n, m)
    return (u[:, :k] * np.geomspace(3e-2, 1e-3, k)) @ v[:, :k].T


def draws(response: np.ndarray, spread: float):
    def draw(rng: np.random.Generator) -> np.ndarray:
        return response + spread * rng.standard_normal((4, *response.shape))

    return draw


@pytest.mark.parametrize("loss", ["rms", "relative", "log"])
def test_gradient_is_that_of_an_independent_rollout(loss: str) -> None:
    response = ring()
    settings = TrajectorySettings(
        loss=loss,
        horizon=3,
        batch=5,
        discount=0.8,
        change_cost=1e-3,
        setpoint_cost=2e-3,
        smallest_amplitude=None,
        log_floor=1e-5,
        hidden=9,
        coordinates="raw",
        orbit_scale=2e-4,
        change_scale=1e-2,
    )
    network = build(response, settings, None, settings.hidden)
    model = LinearResponses(response, CPU)
    value = TrajectoryLoss(
        network,
        lambda _: (model, 1),
        response,
        settings,
        1,
        torch.Generator().manual_seed(3),
        CPU,
    )(0)
    value.backward()
    weights = [w.detach().numpy().astype(np.float64) for w in network.perceptron.weights]
    drawn = torch.randn(5, 12, generator=torch.Generator().manual_seed(3)).numpy()

    def by_hand(matrices: list[np.ndarray]) -> float:
        orbit = 0.25e-3 * drawn.astype(np.float64)
        first = np.sqrt((orbit**2).mean(1))
        total, norm, summed = 0.0, 0.0, 0.0
        for n in range(3):
            x = orbit / 2e-4
            for matrix in matrices[:-1]:
                x = np.tanh(x @ matrix.T)
            change = 1e-2 * x @ matrices[-1].T
            orbit = orbit + change @ response.T
            summed = summed + change
            price = np.sqrt((orbit**2).mean(1)) + 1e-3 * np.sqrt((change**2).mean(1))
            price = price + 2e-3 * np.sqrt((summed**2).mean(1))
            cost = {
                "rms": price / 0.25e-3,
                "relative": price / first,
                "log": np.log(np.sqrt(price**2 + 1e-10) / 0.25e-3),
            }[loss]
            total += 0.8**n * cost.mean()
            norm += 0.8**n
        return total / norm

    assert float(value.detach()) == pytest.approx(by_hand(weights), rel=1e-5)
    rng = np.random.default_rng(0)
    for index, weight in enumerate(network.perceptron.weights):
        direction = rng.standard_normal(weights[index].shape)
        sides = []
        for sign in (1.0, -1.0):
            moved = list(weights)
            moved[index] = moved[index] + sign * 1e-5 * direction
            sides.append(by_hand(moved))
        expected = (sides[0] - sides[1]) / 2e-5
        assert weight.grad is not None
        gained = float(np.sum(weight.grad.numpy() * direction))
        assert gained == pytest.approx(expected, rel=2e-3, abs=2e-6)


def test_one_step_without_noise_is_learnt_as_the_inverse() -> None:
    response = ring()
    settings = TrajectorySettings(horizon=1, iterations=400, hidden=36, learning_rate=3e-3)
    result = train_trajectory(response, settings, device="cpu")
    orbits = 1e-5 * np.random.default_rng(1).standard_normal((64, 12))
    wanted = -np.linalg.solve(response, orbits.T).T
    left = orbits + result.policy.changes(orbits) @ response.T
    assert np.linalg.norm(left) < 0.1 * np.linalg.norm(orbits)
    error = np.linalg.norm(result.policy.changes(orbits) - wanted) / np.linalg.norm(wanted)
    assert error < 0.15
    assert result.figures["spectral_radius"] < 0.2
    assert result.curve[-1] < 0.1 < result.curve[0]


@pytest.mark.nightly
def test_modes_reach_what_raw_coordinates_do_not() -> None:
    response = ring()
    shared = {"iterations": 150, "hidden": 36}
    modes = train_trajectory(response, TrajectorySettings(**shared), device="cpu")
    raw = train_trajectory(response, TrajectorySettings.paper(**shared), device="cpu")
    assert modes.figures["spectral_radius"] < 0.3 < raw.figures["spectral_radius"]


@pytest.mark.parametrize("shape", [(12, 12), (14, 10), (10, 14)])
@pytest.mark.parametrize("kind", ["raw", "modes"])
def test_export_acts_as_the_network_in_training(shape: tuple[int, int], kind: str) -> None:
    response = ring(*shape)
    settings = TrajectorySettings(iterations=3, hidden=20, coordinates=kind, change_scale=0.02)
    network = build(response, settings, None, 20)
    orbits = 1e-4 * np.random.default_rng(0).standard_normal((7, shape[0]))
    inside = network(torch.from_numpy(orbits.astype(np.float32))).detach().numpy()
    policy = network.export(response)
    scale = np.abs(inside).max()
    np.testing.assert_allclose(policy.changes(orbits), inside, atol=1e-5 * scale)
    # Taken in again, in the other coordinates too, it is the same network still.
    other = "raw" if kind == "modes" else "modes"
    for coordinates in (kind, other):
        again = settings.model_copy(update={"coordinates": coordinates, "output_scale": 0.3})
        back = build(response, again, policy).export(response)
        np.testing.assert_allclose(back.changes(orbits), inside, atol=2e-5 * scale)


def test_coordinates_of_modes_that_are_not_there_stay_finite() -> None:
    response = ring()
    response[:, 0] = 0.0
    coordinates = Coordinates.modes(response, 1e-3)
    assert np.isfinite(coordinates.outward).all()
    np.testing.assert_allclose(
        coordinates.outward @ coordinates.outward_inverse, np.eye(12), atol=1e-9
    )


def test_curricula_widen_horizon_and_amplitudes() -> None:
    settings = RolloutSettings(
        horizon=9,
        amplitude=1e-3,
        smallest_amplitude=1e-6,
        horizon_curriculum=0.5,
        amplitude_curriculum=1.0,
    )
    stages = [stage(settings, iteration, 100) for iteration in (0, 25, 50, 99)]
    assert [now.horizon for now in stages] == [1, 5, 9, 9]
    assert stages[0].smallest == pytest.approx(1e-3)
    assert stages[2].smallest == pytest.approx(1e-3 * 10**-1.5)
    assert all(now.largest == 1e-3 for now in stages)
    at_once = stage(RolloutSettings(horizon=9), 0, 100)
    assert (at_once.horizon, at_once.smallest) == (9, pytest.approx(0.25e-6))
    with pytest.raises(ValueError, match="smallest_amplitude"):
        RolloutSettings(amplitude=1e-6, smallest_amplitude=1e-3)


@pytest.mark.parametrize("trained", ["last", "output", "spare"])
def test_weights_that_are_not_trained_stay(trained: str) -> None:
    response = ring()
    law = embed(ModalPolicy(response, ModalSettings()))
    settings = TrajectorySettings(trained=trained, iterations=5, learning_rate=1e-2)
    network = build(response, settings, law)
    orbits = 1e-5 * np.random.default_rng(0).standard_normal((5, 12))
    before = network.export(response)
    scale = np.abs(law.changes(orbits)).max()
    np.testing.assert_allclose(before.changes(orbits), law.changes(orbits), atol=1e-4 * scale)
    weights = [w.detach().clone() for w in network.perceptron.weights]
    model = LinearResponses(response, CPU)
    descend(network, lambda _: (model, 1), response, settings, CPU)
    used = [np.any(w, axis=1) for w in law.weights[:-1]]
    for index, (old, new) in enumerate(zip(weights, network.perceptron.weights, strict=True)):
        moved = (old != new.detach()).numpy()
        if trained == "output" or (trained == "last" and index < 3):
            assert not moved.any()
        elif trained == "last":
            assert moved.any()
        elif index < 3:
            assert not moved[used[index]].any()
            assert moved[~used[index]].any()
        else:
            assert not moved[:, used[2]].any()
            assert moved[:, ~used[2]].any()
    assert network.export(response).policy_id != before.policy_id


def test_a_part_cannot_be_trained_of_a_random_network() -> None:
    with pytest.raises(ConfigError, match="start"):
        train_trajectory(ring(), TrajectorySettings(trained="last"), device="cpu")


def test_start_of_another_ring_is_refused() -> None:
    start = embed(ModalPolicy(ring(14, 10), ModalSettings()))
    with pytest.raises(ConfigError, match="same ring"):
        train_trajectory(ring(), TrajectorySettings(), start=start, device="cpu")


def test_interrupted_training_goes_on_as_if_it_had_not_been(tmp_path) -> None:
    response = ring()
    settings = TrajectorySettings(
        iterations=160, batch=8, hidden=12, reading_noise=1e-6, kick_noise=1e-6
    )
    draw = draws(response, 1e-4)
    whole = train_trajectory(response, settings, draw=draw, device="cpu")

    class PulledError(Exception):
        pass

    def pull(done: int, _loss: float) -> None:
        if done == 130:
            raise PulledError

    with pytest.raises(PulledError):
        train_trajectory(
            response, settings, draw=draw, device="cpu", progress=pull, checkpoint=tmp_path
        )
    first = []
    resumed = train_trajectory(
        response,
        settings,
        draw=draw,
        device="cpu",
        progress=lambda done, _loss: first.append(done),
        checkpoint=tmp_path,
    )
    assert 1 < first[0] <= 131
    assert resumed.policy.policy_id == whole.policy.policy_id
    assert resumed.curve == whole.curve


def test_seeds_decide() -> None:
    response = ring()
    settings = TrajectorySettings(iterations=4, batch=8, hidden=12)
    one, same = (train_trajectory(response, settings, device="cpu") for _ in range(2))
    other = train_trajectory(response, settings.model_copy(update={"seed": 1}), device="cpu")
    assert one.policy.policy_id == same.policy.policy_id != other.policy.policy_id
    assert one.seeds == {"seed": 0}


def test_model_as_a_function_takes_the_place_of_the_matrix() -> None:
    response = ring()
    settings = TrajectorySettings(iterations=5, batch=8, hidden=12)
    matrix = torch.from_numpy(response.T.astype(np.float32))
    known = train_trajectory(response, settings, device="cpu")
    given = train_trajectory(
        response, settings, model=lambda orbit, change: orbit + change @ matrix, device="cpu"
    )
    np.testing.assert_allclose(given.curve, known.curve, rtol=1e-5)
    with pytest.raises(ConfigError, match="not both"):
        train_trajectory(
            response, settings, model=lambda o, c: o, draw=draws(response, 1.0), device="cpu"
        )


def test_groups_of_responses_each_move_their_own_trajectories() -> None:
    responses = np.stack([ring(seed=seed) for seed in range(3)])
    orbit = np.random.default_rng(0).standard_normal((6, 12)).astype(np.float32)
    change = np.random.default_rng(1).standard_normal((6, 12)).astype(np.float32)
    moved = LinearResponses(responses, CPU)(torch.from_numpy(orbit), torch.from_numpy(change))
    for row in range(6):
        np.testing.assert_allclose(
            moved[row].numpy(), orbit[row] + responses[row // 2] @ change[row], rtol=1e-5
        )


@pytest.mark.nightly
def test_drawn_responses_make_the_policy_hold_for_all_of_them() -> None:
    response = ring()
    rng = np.random.default_rng(5)
    spread = 4e-4
    others = response + spread * rng.standard_normal((16, 12, 12))
    settings = TrajectorySettings(iterations=200, hidden=36)
    exact = train_trajectory(response, settings, device="cpu")
    robust = train_trajectory(response, settings, draw=draws(response, spread), device="cpu")
    trial = Rehearsal(amplitude=1e-4, steps=20)
    assert (
        judge(robust.policy, others, trial).score < judge(exact.policy, others, trial).score - 0.05
    )


def test_what_is_not_finite_is_refused() -> None:
    response = ring()
    settings = TrajectorySettings(iterations=5, batch=4, hidden=8)
    with pytest.raises(TrainingError, match="not finite"):
        train_trajectory(
            response, settings, model=lambda orbit, change: orbit * torch.nan, device="cpu"
        )
    with pytest.raises(RingError, match="finite"):
        train_trajectory(
            response, settings, draw=lambda rng: np.full((2, 12, 12), np.inf), device="cpu"
        )
    with pytest.raises(RingError, match="finite"):
        train_trajectory(np.full((12, 12), np.nan), settings, device="cpu")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU here")
def test_a_gpu_that_is_not_there_is_refused() -> None:
    with pytest.raises(ConfigError, match="GPU"):
        train_trajectory(ring(), TrajectorySettings(iterations=1), device="cuda")


@pytest.mark.nightly
def test_fine_tuning_improves_a_network_whose_ring_has_moved() -> None:
    response = ring()
    settings = TrajectorySettings(iterations=150, hidden=36)
    incumbent = train_trajectory(response, settings, device="cpu").policy
    # Far enough for the old gains to ring: a mode that is merely corrected too weakly has the
    # lower noise floor, and what corrects it fully would rightly be refused.
    moved = response + 4e-4 * np.random.default_rng(7).standard_normal(response.shape)
    samples = moved + 1e-5 * np.random.default_rng(8).standard_normal((24, 12, 12))
    tune = FineTuneSettings(iterations=60, trained="all", reading_noise=1e-8)
    result = fine_tune(incumbent, samples, tune)
    figures = result.figures
    assert figures["improved"] == 1.0
    assert result.policy is not incumbent
    np.testing.assert_allclose(result.policy.response, samples.mean(0))
    fresh = moved + 1e-5 * np.random.default_rng(9).standard_normal((8, 12, 12))
    trial = Rehearsal(reading_noise=1e-8, seed=4)
    assert judge(result.policy, fresh, trial).score < judge(incumbent, fresh, trial).score
    assert figures["after_floor"] <= 1.01 * figures["before_floor"]


@pytest.mark.parametrize("rate", [1.0, 1e30])
def test_fine_tuning_that_destroys_keeps_the_incumbent(rate: float) -> None:
    response = ring()
    incumbent = embed(ModalPolicy(response, ModalSettings()))
    samples = np.repeat(response[None], 6, axis=0)
    settings = FineTuneSettings(trained="all", learning_rate=rate, final_learning_rate=None)
    result = fine_tune(incumbent, samples, settings)
    assert result.policy is incumbent
    assert result.figures["improved"] == 0.0
    before, after = result.figures["before_score"], result.figures["after_score"]
    assert after >= before


def test_fine_tuning_refuses_samples_of_another_ring() -> None:
    incumbent = embed(ModalPolicy(ring(), ModalSettings()))
    with pytest.raises(RingError, match="samples"):
        fine_tune(incumbent, np.ones((2, 10, 14)))
    with pytest.raises(RingError, match="finite"):
        fine_tune(incumbent, np.full((2, 12, 12), np.nan))


def test_rehearsal_of_a_linear_law_is_what_the_theory_says() -> None:
    response, gain = ring(), 0.3
    inverse = gain * np.linalg.inv(response)

    class Linear:
        def changes(self, errors: np.ndarray) -> np.ndarray:
            return -errors @ inverse.T

    rings = np.repeat(response[None], 40, axis=0)
    quiet = rehearse(Linear(), rings, Rehearsal(reading_noise=0.0, steps=5))
    np.testing.assert_allclose(quiet[5], quiet[0] * 0.7**5, rtol=1e-9)
    # Static gain against white reading noise leaves σ √(g / (2 − g)) on the true orbit.
    noisy = judge(Linear(), rings, Rehearsal(amplitude=1e-9, reading_noise=2e-7, steps=400))
    assert noisy.floor == pytest.approx(2e-7 * np.sqrt(0.3 / 1.7), rel=0.03)
    assert spectral_radius(inverse, response) == pytest.approx(0.7)
    assert spectral_radius(-inverse, response) == pytest.approx(1.3)
    tall = ring(14, 10)
    assert spectral_radius(np.linalg.pinv(tall), tall) == pytest.approx(0.0, abs=1e-9)

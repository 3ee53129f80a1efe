"""Supervised training on small rings: the clone, the under-trained clone, and the three sources."""

import signal
from functools import cache

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from orbitfb.core.errors import ConfigError, EstimationError, StoreError
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.policies.training.supervised import train_supervised
from orbitfb.policies.training.supervised_settings import SupervisedSettings

SIZE = 12


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ill_conditioned(bpms=SIZE, correctors=SIZE, decades=3.0):
    """Singular values over three decades, as those of a ring [m/A]."""
    rng = np.random.default_rng(3)
    u = np.linalg.qr(rng.normal(size=(bpms, bpms)))[0]
    v = np.linalg.qr(rng.normal(size=(correctors, correctors)))[0]
    sigma = np.zeros((bpms, correctors))
    np.fill_diagonal(sigma, 4e-2 * np.logspace(0, -decades, min(bpms, correctors)))
    return u @ sigma @ v.T


RESPONSE = ill_conditioned()
TEACHER = SvdPolicy(RESPONSE, SvdSettings(gain=1.0, regularisation=3e-4))


def train(response=RESPONSE, teacher=TEACHER, **chosen):
    options = {
        key: chosen.pop(key) for key in ("archive", "progress", "checkpoint") if key in chosen
    }
    settings = SupervisedSettings(**chosen)
    return train_supervised(response, settings, teacher=teacher, device="cpu", **options)


@cache
def done_right():
    return train()


def closed_loop(law, response=RESPONSE, ticks=3000, noise=0.2e-6):
    """Rms of 8 orbits after some ticks of s' = s + R π(s + noise), from 250 µm."""
    rng = np.random.default_rng(11)
    orbits = 250e-6 * rng.normal(size=(8, len(response)))
    for _ in range(ticks):
        read = orbits + noise * rng.normal(size=orbits.shape)
        orbits = orbits + law.changes(read) @ response.T
    return np.sqrt(np.mean(orbits**2))


def test_done_right_it_corrects_as_its_teacher_does():
    result = done_right()
    for ticks in (3, 100, 3000):
        ours, theirs = closed_loop(result.policy, ticks=ticks), closed_loop(TEACHER, ticks=ticks)
        assert 0.9 * theirs < ours < 1.1 * theirs
    assert result.figures["gain_error"] < 0.1
    assert result.figures["growth"] <= 1.0
    assert result.figures["label_growth"] == pytest.approx(1 - 4e-5**2 / (4e-5**2 + 3e-4**2))


@pytest.mark.nightly
def test_the_error_of_the_orbit_alone_leaves_the_slow_modes_unlearnt():
    """Why the coordinates of the teacher: weighted by R, the same budget is far from a slow law."""
    slow = SvdPolicy(RESPONSE, SvdSettings(gain=1.0, regularisation=4e-3))
    weighted = train(coordinates="modes", teacher=slow)
    relative = train(coordinates="teacher", teacher=slow)
    assert weighted.figures["orbit_error"] < 0.2
    assert weighted.figures["gain_error"] > 10 * relative.figures["gain_error"]


@pytest.mark.nightly
def test_the_paper_s_budget_gives_an_under_trained_clone():
    settings = SupervisedSettings.paper()
    result = train_supervised(RESPONSE, settings, teacher=TEACHER, device="cpu")
    assert result.figures["label_error"] > 3 * done_right().figures["label_error"]
    assert result.settings["coordinates"] == "raw"
    assert len(result.curve) == settings.iterations


def test_figures_are_those_of_the_policy():
    result = train(iterations=20)
    slope = result.policy.gain_matrix
    miss = np.linalg.solve(TEACHER.gain_matrix, slope - TEACHER.gain_matrix)
    assert result.figures["gain_error"] == pytest.approx(np.linalg.norm(miss, 2), rel=1e-6)
    growth = np.abs(np.linalg.eigvals(np.eye(SIZE) - RESPONSE @ slope)).max()
    assert result.figures["growth"] == pytest.approx(growth)


def test_random_actions_run_forward_teach_the_inverse():
    result = train(source="actions", teacher=None)
    inverse = np.linalg.inv(RESPONSE)
    miss = RESPONSE @ (result.policy.gain_matrix - inverse)
    assert np.linalg.norm(miss, 2) < 0.2
    assert result.figures["label_growth"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.nightly
def test_equal_actions_do_not_teach_the_weak_modes():
    white = train(source="actions", excitation="white", coordinates="modes", teacher=None)
    equal = train(source="actions", excitation="modes", coordinates="modes", teacher=None)
    assert white.figures["gain_error"] > 3 * equal.figures["gain_error"]


def recorded(rows=400, noise=0.2e-6):
    """Operation under the teacher at the noise floor, as an archive would hold it."""
    rng = np.random.default_rng(5)
    orbit, errors, changes = 10e-6 * rng.normal(size=SIZE), [], []
    for _ in range(rows):
        read = orbit + noise * rng.normal(size=SIZE)
        change = TEACHER.changes(read)
        errors.append(read)
        changes.append(change)
        orbit = orbit + RESPONSE @ change + 0.1e-6 * rng.normal(size=SIZE)
    return np.array(errors), np.array(changes)


def test_an_archive_of_operation_teaches_the_law_that_ran():
    errors, changes = recorded()
    errors[7, 3] = np.nan
    result = train(source="archive", archive=(errors, changes), teacher=None)
    assert result.figures["gain_error"] < 0.15
    assert closed_loop(result.policy) < 1.1 * closed_loop(TEACHER)


def test_an_archive_that_is_too_small_or_torn_is_refused():
    errors, changes = recorded(20)
    with pytest.raises(EstimationError, match="too few"):
        train(source="archive", archive=(errors[:11], changes[:11]), teacher=None)
    with pytest.raises(EstimationError, match="no rows of one archive"):
        train(source="archive", archive=(errors, changes[:-1]), teacher=None)


def test_a_source_without_its_data_is_refused():
    with pytest.raises(ConfigError, match="teacher"):
        train(teacher=None)
    with pytest.raises(ConfigError, match="archive"):
        train(source="archive")


@pytest.mark.parametrize("shape", [(14, 9), (9, 14)])
def test_rings_need_not_be_square(shape):
    response = ill_conditioned(*shape, decades=1.5)
    teacher = SvdPolicy(response, SvdSettings(gain=0.8, regularisation=1e-3))
    result = train(response, teacher)
    expected = closed_loop(teacher, response, 200)
    assert closed_loop(result.policy, response, 200) < 1.1 * expected
    assert result.policy.gain_matrix.shape == shape[::-1]


def test_a_teacher_that_cuts_modes_is_learnt_with_its_cut():
    teacher = SvdPolicy(RESPONSE, SvdSettings(gain=1.0, regularisation=0.0, singular_values=5))
    result = train(teacher=teacher)
    untouched = np.linalg.svd(RESPONSE)[0][:, 7]
    change = result.policy.changes(1e-4 * untouched)
    assert np.linalg.norm(RESPONSE @ change) < 0.05 * 1e-4


def test_it_is_the_same_again_and_after_an_interruption(tmp_path):
    whole = train(iterations=30)
    assert whole.policy.policy_id == train(iterations=30).policy.policy_id
    assert whole.policy.policy_id != train(iterations=30, seed=1).policy.policy_id

    def kept(**chosen):
        return train(iterations=30, checkpoint=tmp_path, **chosen)

    with pytest.raises(KeyboardInterrupt):
        kept(progress=_interrupt_at(12))
    resumed = kept()
    assert resumed.policy.policy_id == whole.policy.policy_id
    assert resumed.curve == whole.curve
    with pytest.raises(StoreError, match="settings"):
        kept(batch=65)


def _interrupt_at(iteration):
    def interrupt(done, _loss):
        if done == iteration:
            signal.raise_signal(signal.SIGINT)

    return interrupt


def test_amplitudes_in_the_wrong_order_are_refused():
    with pytest.raises(ValidationError, match="above amplitude"):
        SupervisedSettings(amplitude=1e-6, smallest_amplitude=1e-5)

"""Steps of a rounded quantity are found; those that noise alone would make are not proposed."""

import numpy as np
import pytest

from orbitfb.effects.actuators.rounding import common_steps, single_steps

ROWS, COLUMNS, FINEST = 900, 40, 0.6e-3


def setpoints() -> np.ndarray:
    """Currents of correctors that are far from zero and move by some milliamperes."""
    rng = np.random.default_rng(5)
    moves = np.cumsum(rng.normal(0.0, 0.2e-3, (ROWS, COLUMNS)), axis=0)
    return rng.normal(0.0, 0.5, COLUMNS) + moves + rng.normal(0.0, 2e-3, (ROWS, COLUMNS))


def pull_of(currents: np.ndarray, step: float, columns: list[int], gain: float) -> np.ndarray:
    """Unit noise, and what rounding some columns to a step adds to it: gain nats each."""
    pull = np.random.default_rng(6).standard_normal(currents.shape)
    for column in columns:
        error = np.round(currents[:, column] / step) * step - currents[:, column]
        pull[:, column] += error * np.sqrt(2.0 * gain / np.sum(error**2))
    return pull


def height(currents: np.ndarray, pull: np.ndarray, step: float) -> float:
    """Score of a step in standard deviations."""
    error = np.round(currents / step) * step - currents
    return float(np.sum(pull * error) / np.sqrt(np.sum(error**2)))


# Over a small part of the range steps that are a whole turn apart at its middle are alike.
@pytest.mark.parametrize("step", [0.7e-3, 1.3e-3, 3e-3])
def test_a_step_as_good_as_that_of_one_column_far_from_zero_is_found(step: float):
    currents = setpoints()
    pull = pull_of(currents, step, [7], 40.0)
    (found, *_) = single_steps(currents, pull, FINEST, 5)
    own = currents[:, 7], pull[:, 7]
    assert height(*own, found) > 0.98 * height(*own, step) > 6.0


@pytest.mark.parametrize("step", [0.7e-3, 1.3e-3, 3e-3])
def test_the_step_of_all_columns_is_found(step: float):
    currents = setpoints()
    pull = pull_of(currents, step, list(range(COLUMNS)), 4.0)
    found = common_steps(currents, pull, FINEST, 5)
    assert found and abs(found[0] / step - 1.0) < 1e-4


@pytest.mark.parametrize("step", [0.7e-3, 3e-3])
def test_the_step_of_a_crate_is_found_that_shows_in_no_column_and_not_in_all(step: float):
    currents, crate = setpoints(), list(range(12, 17))
    pull = pull_of(currents, step, crate, 6.0)
    groups = [np.arange(first, first + 5) for first in range(2, COLUMNS - 5, 5)]
    assert any(list(group) == crate for group in groups)
    (found, *_) = common_steps(currents, pull, FINEST, 5, groups)
    assert abs(found / step - 1.0) < 1e-4
    others = common_steps(currents, pull, FINEST, 5) + single_steps(currents, pull, FINEST, 5)
    assert all(abs(other / step - 1.0) > 1e-4 for other in others)


@pytest.mark.nightly
def test_noise_alone_proposes_next_to_nothing():
    currents, proposed = setpoints(), 0
    groups = [np.arange(first, first + 5) for first in range(0, COLUMNS, 5)]
    for seed in range(8):
        pull = np.random.default_rng(seed).standard_normal(currents.shape)
        proposed += len(common_steps(currents, pull, FINEST, 5))
        proposed += len(common_steps(currents, pull, FINEST, 5, groups))
        proposed += len(single_steps(currents, pull, FINEST, 5))
    assert proposed <= 24  # three of fifteen a time at most

"""The prefilter against the Kalman filter that it stands for, tick by tick."""

import numpy as np
import pytest

from orbitfb.models.filter import PrefilterBank, ground_ratio, innovation_ratio

GAINS = np.array([0.02, 0.3, 0.8])


def kalman(differences, starts, gain):
    """Innovations of a random walk seen through white noise, and their variances over r²."""
    step = gain**2 / (1 - gain)
    innovations, variances = [], []
    for difference, start in zip(differences, starts, strict=True):
        if start:
            state, variance, reading = 0.0, 1.0, 0.0  # the first reading is all that is known
        variance += step
        reading += difference
        innovation = reading - state
        innovations.append(innovation)
        variances.append(variance + 1)
        share = variance / (variance + 1)
        state += share * innovation
        variance *= 1 - share
    return np.array(innovations), np.array(variances)


@pytest.mark.parametrize("cuts", [(0,), (0, 40), (0, 70, 71, 150)])
def test_equals_kalman_filter_through_gaps_and_blocks(cuts):
    rows = np.random.default_rng(1).standard_normal((200, 2))
    starts = np.isin(np.arange(200), cuts)
    bank = PrefilterBank(GAINS)
    carry = bank.start(2)
    pieces = []
    for begin, end in ((0, 33), (33, 130), (130, 200)):
        filtered, weights, carry = bank.run(rows[begin:end], starts[begin:end], carry)
        pieces.append((filtered, weights))
    filtered = np.concatenate([piece[0] for piece in pieces], axis=1)
    weights = np.concatenate([piece[1] for piece in pieces], axis=1)
    for level, gain in enumerate(GAINS):
        innovations, variances = kalman(rows[:, 1], starts, gain)
        assert np.allclose(filtered[level, :, 1], innovations)
        assert np.allclose(weights[level] ** 2, innovation_ratio(gain) / variances)


def test_steady_gain_belongs_to_the_ground():
    ratio = ground_ratio(GAINS)
    variance = np.ones(3)
    for _ in range(3000):
        predicted = variance + ratio
        variance = predicted / (predicted + 1)
    assert np.allclose(variance, GAINS)

"""The variances of the orbit's filter against the plain recursion, at whatever order of calls."""

import numpy as np
import pytest

from orbitfb.estimation.recursive.orbit import OrbitFilter, at_rest

NOISE = 4e-14
STEPS = np.array([1e-18, 1.6e-17, 1e-15, 4e-14, 1e-10])


def alike(found, expected):
    return np.max(np.abs(found / expected - 1.0)) < 1e-9


def test_at_rest_nothing_changes_any_more():
    rest = at_rest(STEPS, NOISE)
    np.testing.assert_allclose(rest * NOISE / (rest + NOISE) + STEPS, rest, rtol=1e-9)


@pytest.mark.parametrize("steps", [STEPS[2:], STEPS])
def test_it_is_the_plain_recursion(steps):
    """Long enough to rest, then a missed reading, one that is read twice, and a kick."""
    mine, variances = OrbitFilter(steps, NOISE), np.zeros(len(steps))
    rng = np.random.default_rng(1)

    def forget():
        nonlocal variances
        variances = np.full(len(steps), 1e8 * NOISE)
        mine.forget(1e8 * NOISE)

    def predict():
        nonlocal variances
        variances = variances + steps
        mine.predict()

    def read():
        nonlocal variances
        expected, shares = mine.weigh()
        assert alike(expected, variances + NOISE) and alike(shares, NOISE / (variances + NOISE))
        variances = variances * NOISE / (variances + NOISE)
        mine.update()

    odd = (predict, read, forget, lambda: None)
    forget()
    read()
    for tick in range(5000):
        predict()
        if tick % 1100 == 1099:
            odd[rng.integers(len(odd))]()
        assert alike(mine.variances, variances)
        read()
        assert alike(mine.variances, variances)
        if tick % 1300 == 1299:
            odd[rng.integers(len(odd))]()
    predict()
    assert (mine.weigh()[0] is mine.weigh()[0]) == (len(steps) == 3)  # it came to rest

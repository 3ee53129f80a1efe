"""What the curvature of a likelihood says of its values."""

import numpy as np
import pytest
from gap_cases import bench, gain_error

from orbitfb.diagnose import fit_scores
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.fit_scores import BLOCK, FEW_BLOCKS, inverse, telling


def test_a_value_in_radians_does_not_hide_one_in_logarithms():
    scale = np.array([5e-9, 1.5])
    deviation = np.array([1e-10, 0.1])
    correlation = np.array([[1.0, -0.8], [-0.8, 1.0]])
    covariance = correlation * np.outer(deviation, deviation)
    curvature = np.linalg.inv(covariance)
    np.testing.assert_allclose(inverse(curvature, scale), covariance, rtol=1e-3)


def test_a_value_of_which_nothing_is_known_stays_finite():
    scale = np.array([5e-9, 1.5])
    known = inverse(np.diag([1e20, 0.0]), scale)
    assert np.isclose(known[0, 0], 1e-20)
    assert known[1, 1] <= (1e3 * scale[1]) ** 2 * (1 + 1e-9)


def test_what_happens_once_is_told_by_one_block_and_what_goes_on_by_all():
    once, always = np.zeros(20 * BLOCK), np.ones(20 * BLOCK)
    once[[70, 72]] = 1.0
    assert np.isclose(telling(once), 1.0)
    assert np.isclose(telling(always), 20.0)
    assert telling(once + 1e-3 * always) < FEW_BLOCKS < telling(once + 0.1 * always)


@pytest.mark.parametrize(("blocks", "held"), [(2.0, True), (20.0, False)])
def test_only_what_goes_on_is_refuted_by_the_other_half(monkeypatch, blocks, held):
    def refuted(scale, now, slopes, rows, gains):
        return -np.ones_like(gains), np.zeros(len(scale), dtype=np.bool_)

    monkeypatch.setattr(fit_scores, "held_out", refuted)
    monkeypatch.setattr(fit_scores, "telling", lambda known: blocks)
    found = fit(bench(with_error=True), (gain_error(),))
    assert (found.held_out == pytest.approx(found.gain)) is held
    assert (found.held_out > 0.0) is held

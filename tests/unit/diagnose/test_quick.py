"""What is computed in blocks, and in single precision, is what plain loops in double give."""

import numpy as np
import pytest

from orbitfb.diagnose.healing import Errors
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.noise_modes import NoiseModes
from orbitfb.diagnose.quick import Quick
from orbitfb.diagnose.recursion import Feedback
from orbitfb.diagnose.uncoupled import Product, components
from orbitfb.physics.optics import Matrix


def _two_planes(rng: np.random.Generator) -> Matrix:
    matrix = np.zeros((8, 12))
    matrix[:5, ::2] = rng.normal(size=(5, 6))
    matrix[5:, 1::2] = rng.normal(size=(3, 6))
    return matrix


@pytest.mark.parametrize("rows", [1, 2, 31, 32, 33, 100])
def test_recursions_of_blocks_are_those_of_rows(rows: int) -> None:
    rng = np.random.default_rng(rows)
    steps, each = rng.normal(size=(rows, 4)), rng.uniform(size=(120, 4))
    forth, back = steps.copy(), steps.copy()
    for row in range(1, rows):
        forth[row] += each[row] * forth[row - 1]
    for row in range(rows - 2, -1, -1):
        back[row] += each[row + 1] * back[row + 1]
    feedback, found, other = Feedback.of(each), steps.copy(), steps.copy()
    feedback.forward(found)
    feedback.backward(other)
    np.testing.assert_allclose(found, forth, atol=1e-12)
    np.testing.assert_allclose(other, back, atol=1e-12)


def test_a_product_of_blocks_is_that_of_the_matrix() -> None:
    rng = np.random.default_rng(4)
    matrix = _two_planes(rng)
    assert len(components(matrix)) == 2
    product = Product.of(matrix, np.float64)
    left, right = rng.normal(size=(5, 8)), rng.normal(size=(5, 12))
    np.testing.assert_allclose(product.right(left), left @ matrix)
    np.testing.assert_allclose(product.back(right), right @ matrix.T)


def test_single_precision_whitens_as_double_does() -> None:
    rng = np.random.default_rng(5)
    axes = np.linalg.qr(rng.normal(size=(8, 8)))[0]
    modes = NoiseModes(axes, np.exp(0.5 * rng.normal(size=8)))
    floor = NoiseFloor(modes, 1e-13, 1e-13 * np.exp(np.linspace(-9.0, 1.0, 8)))
    starts = np.zeros(150, dtype=np.bool_)
    starts[[0, 70]] = True
    left = 1e-6 * rng.normal(size=(150, 8)).cumsum(axis=0)
    quick, white = Quick(floor, starts), floor.whiten(left, starts)
    np.testing.assert_allclose(quick.whiten(left.astype(np.float32)), white, atol=1e-4)
    slope = floor.adjoint(white, starts)
    found = quick.adjoint(white.astype(np.float32))
    np.testing.assert_allclose(found, slope, atol=1e-4 * np.abs(slope).max())


def test_small_errors_are_scored_and_added_up_as_their_patterns_say() -> None:
    rng = np.random.default_rng(6)
    patterns = np.hstack([_two_planes(rng), np.eye(8)])
    courses, weights = rng.normal(size=(30, 6)), rng.normal(size=(6, 20))
    weights[:2, :6] = 0.0
    drivers = courses @ weights
    errors = Errors(patterns, courses, weights)
    sizes, slope = rng.normal(size=20), rng.normal(size=(30, 8)).astype(np.float32)
    np.testing.assert_allclose(errors.orbit(sizes), (drivers * sizes) @ patterns.T, atol=1e-4)
    wanted = np.sum((slope @ patterns) * drivers, axis=0)
    np.testing.assert_allclose(errors.score(slope), wanted, atol=1e-4)

"""Sums of squares that no one expects."""

import math

import numpy as np
import pytest

from orbitfb.diagnose.surprise import surprise


def test_of_two_squares_it_is_half_their_sum():
    for squares in (0.0, 3.0, 800.0, 2e4):  # exp(−s / 2), beyond all numbers in the end
        assert surprise(squares, 2) == pytest.approx(0.5 * squares, abs=1e-9)


def test_of_an_even_number_it_is_a_sum_of_powers():
    for squares in (900.0, 1900.0, 5000.0):
        half = 0.5 * squares
        powers = [k * math.log(half) - math.lgamma(k + 1.0) for k in range(90)]
        exact = half - np.logaddexp.reduce(powers)
        assert surprise(squares, 180) == pytest.approx(exact, abs=0.01)

"""The energy of a course that begins in a row, against filtering it with nothing before."""

import numpy as np
import pytest

from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.ladder import Ladder
from orbitfb.diagnose.noise_modes import NoiseModes

ROWS = 150


@pytest.mark.parametrize("walk", [0.0, 0.3])
@pytest.mark.parametrize("holds", [False, True])
def test_what_begins_has_no_past(walk, holds):
    rng = np.random.default_rng(4)
    floor = NoiseFloor(NoiseModes.even(np.eye(3)), 1.0, walk * np.array([1.0, 4.0, 0.2]))
    starts = np.isin(np.arange(ROWS), (0, 90))
    drivers = 3.0 + np.cumsum(rng.normal(size=(ROWS, 2)), axis=0)
    drivers[60:] *= -1.0  # the course itself jumps where it may begin
    ladder = Ladder(floor)
    first = np.zeros_like(drivers) if holds else drivers

    for level in range(len(ladder.feedback)):
        energy, jump = ladder.begun(level, drivers, first, starts)
        for row in (1, 2, 30, 59, 60, 61, 89, 91, 140):
            course = np.where(np.arange(ROWS)[:, None] < row, 0.0, drivers)
            if holds:  # what it had there stays out of it until the next stretch
                course[row:90] -= drivers[row] if row < 90 else 0.0
                course[row:] -= drivers[row] if row >= 90 else 0.0
            alone = ladder.filtered(course, starts)[level]
            np.testing.assert_allclose(energy[row], np.sum(alone**2, axis=0), rtol=2e-3)
        assert np.all(jump[starts] == 0.0)

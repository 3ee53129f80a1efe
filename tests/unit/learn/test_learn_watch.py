"""When a swap is taken back: too large an orbit that does not fall."""

import numpy as np
import pytest

from orbitfb.learn.settings import LearnSettings
from orbitfb.learn.watch import Watch
from orbitfb.policies.svd import SvdPolicy, SvdSettings

SETTINGS = LearnSettings(rollback_factor=2.0, rollback_ticks=5)
FLOOR = 0.2e-6
POLICY = SvdPolicy(np.eye(3), SvdSettings())


class Rows:
    """As much of transitions as a watch looks at: orbits of a given rms."""

    def __init__(self, rms):
        self.orbit = np.outer(rms, np.ones(3))
        self.reference = np.zeros_like(self.orbit)
        self.valid = np.ones(self.orbit.shape, dtype=bool)
        self.closed = np.ones(len(rms), dtype=bool)
        self.tick = np.arange(len(rms))

    def __len__(self):
        return len(self.tick)


def verdict(rms) -> str:
    return Watch(POLICY, POLICY, FLOOR, 0).look(Rows(np.asarray(rms)), SETTINGS)


def test_an_orbit_that_grows_is_taken_back():
    assert "stayed above 0.4 µm" in verdict(FLOOR * 1.2 ** np.arange(20))


def test_an_orbit_that_became_noisy_is_taken_back():
    noisy = 3 * FLOOR * (1 + 0.05 * np.random.default_rng(1).standard_normal(20))
    assert verdict(noisy)


def test_a_kick_that_is_corrected_is_not_the_policys_fault():
    recovery = np.maximum(250e-6 * 0.6 ** np.arange(60), FLOOR)
    assert verdict([FLOOR, FLOOR, *recovery]) == ""


def test_a_kick_that_is_corrected_slowly_is_none_either():
    assert verdict([FLOOR, *(FLOOR + 5e-6 * 0.93 ** np.arange(60))]) == ""


def test_a_kick_that_stays_is():
    assert verdict([FLOOR, FLOOR, *np.full(10, 250e-6)])


def test_an_orbit_that_is_no_number_is():
    assert verdict(np.full(10, np.nan))


@pytest.mark.parametrize("cut", [1, 3, 7])
def test_it_does_not_matter_in_how_many_looks(cut):
    watch, rms = Watch(POLICY, POLICY, FLOOR, 0), FLOOR * 1.2 ** np.arange(20)
    pieces = [rms[begin : begin + cut] for begin in range(0, len(rms), cut)]
    assert any(watch.look(Rows(piece), SETTINGS) for piece in pieces)

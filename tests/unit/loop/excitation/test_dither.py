import numpy as np
import pytest

from orbitfb.loop.excitation.dither import Dither, DitherKind, DitherSettings

RESPONSE = np.random.default_rng(7).standard_normal((12, 8)) * 1e-5


@pytest.mark.parametrize("kind", DitherKind)
@pytest.mark.parametrize("gain", [pytest.param(0.0, marks=pytest.mark.nightly), 0.5])
def test_the_stated_orbit_cost_holds_under_feedback(kind, gain):
    dither = Dither(DitherSettings(orbit_cost=1e-7, kind=kind), RESPONSE, gain)
    inverse = np.linalg.pinv(RESPONSE)
    orbit, squares = np.zeros(12), []
    for _ in range(20_000):
        part = dither.propose()
        dither.settle(part)
        orbit = orbit + RESPONSE @ (part - gain * inverse @ orbit)
        squares.append(np.mean(orbit**2))
    assert np.sqrt(np.mean(squares)) == pytest.approx(1e-7, rel=0.02)


def test_excursions_follow_what_was_written_and_come_again_from_the_seed():
    one, two = (Dither(DitherSettings(orbit_cost=1e-7, seed=3), RESPONSE) for _ in range(2))
    first = one.propose()
    one.settle(0.5 * first)
    np.testing.assert_array_equal(one.excursion, 0.5 * first)
    np.testing.assert_array_equal(two.propose(), first)
    second = one.propose()
    np.testing.assert_allclose(np.abs(one.excursion + second), one.amplitude)
    one.restart()
    assert not one.excursion.any()


def test_off_never_moves():
    dither = Dither.off(4)
    assert dither.propose().shape == (4,)
    assert not dither.propose().any()

"""The fit of a response against tracking: gradients, gains and tunes by an independent way."""

import numpy as np
import pytest
from lazily import Lazy

from orbitfb.loco.measured import Measured
from orbitfb.loco.run import diagnose

at = Lazy("at")


def test_gradients_and_gains_of_a_tracked_ring_come_back(tracked) -> None:
    ring = tracked.ring
    error = np.zeros(len(tracked.quadrupoles))
    error[3], error[10] = 0.02, -0.01
    for number, index in enumerate(tracked.quadrupoles):
        element = tracked.lattice[index]
        b = np.array(element.PolynomB, dtype=float)
        b[1] *= 1.0 + error[number]
        element.PolynomB = b
    gain = np.ones(len(tracked.bpms))
    gain[5] = 1.1
    bpms = {p: ring.places("BPM") for p in ("x", "y")}
    correctors = {p: ring.places("COR") for p in ("x", "y")}
    rng = np.random.default_rng(1)
    response, sigma = {}, {}
    for p in ("x", "y"):
        data = gain[:, None] * tracked.response(p)
        response[p, p] = data + 1e-3 * rng.standard_normal(data.shape)
        sigma[p, p] = np.full(data.shape, 1e-3)
    found = diagnose(ring, Measured(bpms, correctors, response, sigma))
    for p in ("x", "y"):
        assert np.std(found.fit.residual[p]) < 1.1e-3
        assert np.allclose(1 + found.estimates[f"gain:{p}"].value, gain, atol=2e-3)
    assert np.allclose(found.fit.part("gradient"), error, atol=3e-3)
    wanted = at.get_optics(tracked.lattice, np.arange(len(tracked.lattice) + 1))[2].mu[-1]
    for row, p in enumerate(("x", "y")):
        tune = found.optics.tune(p, found.fit.part("gradient"))
        assert tune == pytest.approx(wanted[row] / (2 * np.pi), abs=2e-4)

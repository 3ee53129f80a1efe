"""Pairs of parameters that a response knows only together."""

import numpy as np
import pytest

from orbitfb.loco.answer import answer_of
from orbitfb.loco.output.correlations import correlations
from orbitfb.loco.run import diagnose
from tests.unit.loco.synthetic_responses import synthetic


@pytest.mark.nightly
def test_told_correlations_are_those_of_the_posterior_in_its_gauge() -> None:
    truth = synthetic(3, every=6)
    found = diagnose(truth.ring, truth.measured)
    pairs = correlations(found)
    sizes = [abs(its.correlation) for its in pairs]
    assert sizes == sorted(sizes, reverse=True) and 0.5 <= sizes[-1] <= sizes[0] < 1.0
    # draws of the posterior, its gains over their mean and its calibrations times it
    of = found.fit.groups.of
    theta = np.random.default_rng(1).multivariate_normal(
        found.fit.theta, found.fit.posterior.covariance, 4000, method="cholesky"
    )
    usual = of["gain:x"][~found.estimates["gain:x"].free]
    mean = 1.0 + theta[:, usual].mean(axis=1, keepdims=True)
    gain = (1.0 + theta[:, of["gain:x"]]) / mean
    kick = (1.0 + theta[:, of["scale:x"]] + theta[:, of["calibration:x"]]) * mean
    names = [truth.ring.table.name[i] for i in truth.measured.bpms["x"]]
    others = [truth.ring.table.name[j] for j in truth.measured.correctors["x"]]
    drawn = np.corrcoef(gain.T, kick.T)
    told = {(its.first, its.second): its.correlation for its in pairs}
    strong = 0
    for i, bpm in enumerate(names):
        for j, corrector in enumerate(others):
            rho = drawn[i, len(names) + j]
            its = told.get((f"gain {bpm}:x", f"calibration {corrector}:x"))
            assert its is not None or abs(rho) < 0.55
            if its is not None:
                assert abs(its - rho) < 0.06
                strong += 1
    assert strong
    apart = drawn[: len(names), : len(names)] - np.eye(len(names))
    assert sum(a.startswith("gain") and b.startswith("gain") for a, b in told) < len(names)
    assert np.abs(apart).mean() < 0.2  # without the gauge they all move together


def test_the_answer_has_them() -> None:
    truth = synthetic(3, every=6)
    found = diagnose(truth.ring, truth.measured)
    assert answer_of(found, "m", (), ()).correlations == correlations(found)

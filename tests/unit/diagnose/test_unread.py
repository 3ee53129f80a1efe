"""Readings that a cause has no use for stay as likely as they are without it."""

from dataclasses import replace

import numpy as np
import pytest
from gap_cases import record

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.registry import effect


@pytest.fixture(scope="module")
def still():
    """A beam that does not move, and white reading noise."""
    nothing = record(False)
    noise = 2e-7 * np.random.default_rng(5).standard_normal(nothing.readings.shape)
    return Bench(replace(nothing, readings=noise, setpoints=np.zeros_like(nothing.setpoints)))


def late(first, onset, ticks=8, count=40):
    places = tuple(range(first, first + count))
    return Cause(effect("bpm-latency"), places, {"ticks": float(ticks)}, onset)


@pytest.mark.parametrize("onset", [0, 150])
def test_noise_is_as_likely_in_another_order(still, onset):
    gains = [
        log_likelihood(*still.residual((late(first, onset),))) - still.log_likelihood
        for first in range(0, 140, 20)
    ]
    assert np.abs(gains).max() < 5.0, gains

"""Short records of the simulated ring, with and without an effect, and their benches."""

from functools import cache

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.simulate import simulate_record
from orbitfb.effects.build import layout_of
from orbitfb.effects.registry import effect
from orbitfb.physics.places import Ring

PLACE = 20
GAIN = 0.3


def gain_error(place=PLACE, size=GAIN):
    return Cause(effect("corrector-gain"), (place,), {"gain": size})


@cache
def record(with_error, ticks=400, seed=5, dither=2e-5):
    ring = Ring.load()
    effects = []
    if with_error:
        cause = gain_error()
        rng = np.random.default_rng(0)
        effects = [
            cause.kind.simulate(
                layout_of(ring, "x", 0.1), np.array(cause.places), cause.values, rng
            )
        ]
    return simulate_record(ring, ticks=ticks, seed=seed, effects=effects, dither=dither)


@cache
def bench(with_error, causes=(), seed=5):
    """Causes: sizes of the gain error by place."""
    return Bench(record(with_error, seed=seed), [gain_error(*cause) for cause in causes])

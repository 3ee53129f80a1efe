"""What the naive refit makes of a loop at its noise floor: it confirms the running law."""

from dataclasses import replace
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Environment
from orbitfb.evaluate.paper.naive import naive_response
from orbitfb.evaluate.paper.scenarios import make_scenario

GAINS = (1.0, 0.3)
_SETTLE = 200


def naive_bias(gain: float, plane: Any, seed: int, ticks: int) -> dict[str, float]:
    """Measure the bias of the naive estimate: a task of the campaign.

    The loop runs at its noise floor with a = −K y, K = gain · R⁻¹, on the optics of the ring that
    do not drift. The reading noise of y stands in a and in the difference of the readings, so
    that R̂ tends to (1/2 + 1/gain) R, and R̂ K to 1 + gain / 2 whatever R is.

    Args:
        gain: Of every mode, g [1].
        plane: `x` or `y`.
        seed: Of the noise.
        ticks: Length of the record after the loop has settled [ticks].

    Returns:
        `gain`, `expected` (1 + g / 2) and `found` (mean diagonal of R̂ K).
    """
    physical = make_scenario("s1", plane=plane, seed=seed)
    scenario = replace(physical, end=physical.start, physical=False, walk=None, white=0.0)
    environment = Environment(scenario, (0,))
    law = gain * np.linalg.inv(scenario.start)
    settle = _SETTLE + round(20.0 / gain)
    readings: list[Vector] = []
    changes: list[Vector] = []
    for _ in range(settle + ticks + 1):
        observed = environment.observe()
        change = -observed @ law.T
        readings.append(observed[0])
        changes.append(change[0])
        environment.step(change)
    estimate = naive_response(np.array(readings[settle:]), np.array(changes[settle:-1]))
    return {
        "gain": gain,
        "expected": 1.0 + gain / 2.0,
        "found": float(np.mean(np.diag(estimate @ law))),
    }

"""Whether what goes with a cause's course is the orbit that its law says.

Of what an unknown effect does, the nearest one of the library may have the course in time and
another orbit: a corrector whose current leaks into others passes for a change of its own gain.
"""

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.courses import does
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.surprise import surprise
from orbitfb.effects.device_kinds import SensorKind

_KNOWN = 1e-9
"""Information below which a mode tells nothing of a course, over the most that any one tells."""


def other_orbit(bench: Bench, cause: Cause) -> float:
    """What an orbit of any shape, with the leading course of a cause, gains beyond the causes.

    In every mode of the noise the best amplitude of the course is a normal number of its own, so
    that the sum of their squares has the χ² distribution of as many. Of BPMs it tells nothing:
    what they make of the orbit they make of their noise too.

    Args:
        bench: The record under all causes.
        cause: One of them, with a course in time.

    Returns:
        −log of the chance of such a sum; 0 where the course is none [nats].
    """
    if isinstance(cause.kind, SensorKind) or cause.kind.target == "bpm":
        return 0.0
    floor, starts = bench.floor, bench.record.starts
    made = does(bench, cause)
    sizes, shapes = np.linalg.eigh(made.T @ made)
    if not sizes[-1] > 0.0:
        return 0.0
    everywhere = np.outer(made @ shapes[:, -1], np.ones(len(floor.modes.spread)))
    seen = floor.whiten(floor.to_bpms(everywhere), starts)
    known = np.sum(seen**2, axis=0)
    able = known > _KNOWN * float(known.max())
    if not able.any():
        return 0.0
    pull = np.sum(bench.white * seen, axis=0)[able]
    return surprise(float(np.sum(pull**2 / known[able])), int(able.sum()))

"""Healthy errors that a record leaves open, in a later one that shows more of them.

A later record may be steered through places where the first one was not. What healthy errors do
there nobody could have known, and no cause is to blame for it or gets the credit. So they may do in
the later record whatever the first one leaves open: both are judged as one, the first of them at
the errors that explain it best.
"""

import numpy as np

from orbitfb.diagnose.background import Background
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.free import beyond
from orbitfb.diagnose.healthy_search import HealthySearch
from orbitfb.diagnose.quick import Quick
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

_SOLVED = 0.1
"""Gain of a step of the errors below which they are the best [nats]."""


class OpenErrors:
    """Takes out of a later record what healthy errors may do there.

    Args:
        bench: The first record, under the causes that were found.
        record: The later one.
        currents: That act on the beam in it, shape (N, m) [A].
        orbit: Predicted at the BPMs in it, shape (N, n) [m].
    """

    def __init__(self, bench: Bench, record: Record, currents: Matrix, orbit: Matrix) -> None:
        starts = np.concatenate([bench.record.starts, record.starts])
        both = Background(
            bench.record.layout,
            np.concatenate([bench.currents, currents]),
            np.concatenate([bench.orbit, orbit]),
            starts,
            bench.scale,
        )
        both.prepare(bench.floor)
        self._search = HealthySearch(Quick(bench.floor, starts), both)
        self._before = np.zeros_like(bench.white)

    def left(self, white: Matrix) -> Matrix:
        """What the errors leave of innovations when they do their best against them, (N, n).

        With other innovations it has the scalar product that healthy errors leave of that of both.

        Args:
            white: Of the later record beyond the errors that explain the first one best, (N, n).
        """
        whole = np.concatenate([self._before, white])
        return self._search.against(whole, _SOLVED, beyond())[0][len(self._before) :]

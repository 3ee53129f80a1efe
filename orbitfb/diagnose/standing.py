"""First kicks of errors that begin in the middle of a record.

The error of a magnet kicks by the orbit in it. How that changes, the correctors tell; how far off
its centre the beam stood when the error began they do not: they hold what they had made up for. So
the step at the onset says nothing of the size of the error: it is left free, one amplitude per
place and plane, and the record is looked at across it.

What goes wrong with the currents of correctors from some row on (their scale, their sign, which of
them is which) may make a step, by what they hold, or none, or any: a driver may send increments, or
somebody has made up for what stood still. A step of what they hold and a free one are both tried.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fading import Steps
from orbitfb.diagnose.free import Directions, Few
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.effects.actuators.corrector_gain import CorrectorGain
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_KICK = 0.5e-6
"""Scatter of such a first kick before the data: an error of 0.005 1/m times 100 µm [rad]."""
_CURRENT = 0.02
"""The same of a corrector: a tenth of 0.2 A [A]."""
_REMEMBERED = 4
"""Sets of causes whose steps are kept: the same few are judged again and again."""
_Key = tuple[tuple[str, tuple[int, ...], int], ...]
"""Kind, places and onset of every cause."""


def is_standing(cause: Cause) -> bool:
    """Whether the first kick of a cause is free."""
    kind = cause.kind
    return cause.onset > 0 and (cause.free or (isinstance(kind, SourceKind) and kind.standing))


def stilled(cause: Cause, layout: Layout) -> Cause:
    """The free first kick of a cause without what its law does from then on."""
    if isinstance(cause.kind, SourceKind):
        return replace(cause, values={p.name: p.nominal for p in cause.kind.parameters})
    return Cause(CorrectorGain(), _kicking(cause, layout), {"gain": 0.0}, cause.onset, free=True)


def stretches_across(record: Record, causes: Sequence[Cause]) -> Mask:
    """Rows at which a stretch begins if first kicks may be anything, shape (N,)."""
    starts = record.starts.copy()
    starts[[cause.onset for cause in causes if is_standing(cause)]] = True
    return starts


def price_of_steps(information: Matrix) -> Matrix:
    """What the choice of first kicks of correctors costs, one by one [nats].

    Args:
        information: On a step of each, any shape [1/A²].
    """
    return _price(information * (_CURRENT / _KICK) ** 2)


def _price(information: Matrix) -> Matrix:
    return 0.5 * np.log1p(information * _KICK**2)


class FreeSteps:
    """The steps that first kicks may make, as the noise of one floor sees them.

    Args:
        record: What happened.
        floor: The noise.
    """

    def __init__(self, record: Record, floor: NoiseFloor) -> None:
        self._record, self.floor = record, floor
        self._known: dict[_Key, Steps] = {}

    def basis(self, causes: Sequence[Cause]) -> Directions:
        """Orthonormal innovations that first kicks may have made.

        Args:
            causes: Those with a free first kick count.
        """
        free = tuple(cause for cause in causes if is_standing(cause))
        return self._steps(free) if free else Few(np.zeros((0, self._record.readings.size)))

    def price(self, causes: Sequence[Cause]) -> float:
        """What the choice of the first kicks costs [nats]."""
        free = tuple(cause for cause in causes if is_standing(cause))
        return float(np.sum(_price(self._steps(free).information))) if free else 0.0

    def _steps(self, free: tuple[Cause, ...]) -> Steps:
        """The orbits of kicks of 1 rad since the onsets."""
        key = tuple((cause.kind.id, cause.places, cause.onset) for cause in free)
        if key not in self._known:
            while len(self._known) >= _REMEMBERED:
                del self._known[next(iter(self._known))]
            onsets, orbits = first_kicks(free, self._record.layout)
            self._known[key] = Steps(self.floor, self._record.starts, onsets, orbits)
        return self._known[key]


def first_kicks(causes: Sequence[Cause], layout: Layout) -> tuple[Indices, Matrix]:
    """The first kicks of causes that are free: rows (k,), and orbits of a size each (k, n) [m].

    They are those of 1 rad, at every place and in every plane.
    """
    onsets, orbits = list[int](), [np.zeros((0, len(layout.bpms)))]
    for cause in filter(is_standing, causes):
        kind = cause.kind
        patterns = (
            kind.patterns(layout)
            if isinstance(kind, SourceKind)
            else layout.response * (_CURRENT / _KICK)
        )
        for place in _kicking(cause, layout):
            for plane in layout.planes:
                rows = layout.bpms.in_plane(plane)
                orbit = np.zeros((1, len(patterns)))
                orbit[0, rows] = patterns[rows, place]
                onsets.append(cause.onset)
                orbits.append(orbit)
    return np.array(onsets, dtype=np.intp), np.vstack(orbits)


def _kicking(cause: Cause, layout: Layout) -> tuple[int, ...]:
    """Places whose kick may jump: those of pairs are the columns that get something else."""
    kind = cause.kind
    if not isinstance(kind, PairKind):
        return cause.places
    largest = {p.name: p.high for p in kind.parameters}
    pairs, change = kind.pairs(layout), kind.matrices(layout, largest) - np.eye(2)
    return tuple(
        int(column)
        for place in cause.places
        for column in pairs[place][np.any(change[place] != 0.0, axis=1)]
    )

"""BPMs whose filter of their noise shows more than what it makes of the orbit.

A change of the prediction is all that the adjoint sees. What a BPM does to its own noise it does
not: in a record that nobody shook, that is most of what an averaging BPM shows. Where neighbouring
innovations of a BPM are like each other, or too unlike, the likelihood itself is asked.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.device_groups import crates
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Values
from orbitfb.physics.places import Indices

_PLACES = 2
_VALUES = 3


def of_colour(bench: Bench, kind: SensorKind) -> Iterator[Candidate]:
    """Try the BPMs, and the cell, whose innovations are coloured most."""
    values = _spread(kind.filters(bench.record))
    before = bench.log_likelihood
    for members, name, choices in _coloured(bench, collective=kind.collective):
        causes = [Cause(kind, tuple(int(i) for i in members), one) for one in values]
        gains = [log_likelihood(*bench.residual((cause,))) - before for cause in causes]
        best = int(np.argmax(gains))
        if gains[best] > 0.0:
            yield Candidate(causes[best], float(gains[best]), choices, name)


def _spread(grid: Sequence[Values]) -> list[Values]:
    """A few values of a grid, from all of its range but the ends."""
    rows = np.linspace(0, len(grid) - 1, _VALUES + 2)[1:-1]
    return [grid[round(row)] for row in rows]


def _coloured(bench: Bench, *, collective: bool) -> Iterator[tuple[Indices, str, float]]:
    """Columns of BPMs with their name as a group, and out of how many they were chosen."""
    colour = _colours(bench)
    for place in np.argsort(np.abs(colour))[::-1][:_PLACES]:
        yield np.array([place]), "", float(len(colour))
    groups = crates(bench.record.layout.bpms) if collective else []
    if groups:
        heights = [
            0.5 * len(bench.record) * float(colour[its.members].sum()) ** 2 / len(its.members)
            - np.log(its.choices)
            for its in groups
        ]
        name, columns, choices = groups[int(np.argmax(heights))]
        yield columns, name, choices


def _colours(bench: Bench) -> Vector:
    """Correlation of neighbouring innovations of every BPM, less what is usual, shape (n,)."""
    own = bench.floor.by_bpm(bench.white)
    both = ~(bench.record.starts[1:] | bench.record.starts[:-1])
    products = np.sum((own[1:] * own[:-1])[both], axis=0) / np.sum(own[1:][both] ** 2, axis=0)
    return products - np.median(products)

"""Whether what passes for noise of a BPM follows what the beam does: then it is none.

A reading that takes in a share of another one's, or that bends where the orbit is large, scatters
as much as a noisy one. But it goes with the correctors, which noise does not: the orbit that they
make at any BPM, at its own also the square and the cube, and products of two of its cell, are each
tried as what drives it.

The correctors follow what moves the beam, and where that goes on as it did they tell what is to
come. So do they at BPMs of which nobody says that they are noisy: only more than there counts.
"""

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.noise_spectra import places_struck
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Devices

_FEW_BPMS = 6
"""BPMs that are looked at, at most."""
_OF_A_CELL = 8
"""BPMs of a cell whose products are tried, at most."""
_LAGS = (1, 2, 3)
"""Rows of a BPM's past, and of its orbit's, that are taken as known: the loop has acted on them."""
_FEWEST = 50
"""Rows that tell a share."""
_HEALTHY = 0.02
"""Share of what the correctors do at a BPM that it may get wrong: twice the usual gain error."""
_OTHERS = 12
"""BPMs all around the ring that tell how much the others follow."""
_OCCAM = 2.0
"""What the size of a share costs [nats]."""


def follows(bench: Bench, cause: Cause) -> tuple[str, float]:
    """Try the orbit that the correctors make as what drives the noise of a few BPMs.

    Args:
        bench: The record under all causes.
        cause: Noise, one of them.

    Returns:
        The best course in words, and what it gains over noise of the same BPM, less the price of
        the choice and what it gains at most at others [nats]; nothing and 0 where none gains
        anything.
    """
    kind, record = cause.kind, bench.record
    places = list(places_struck(bench, cause))
    rows = np.flatnonzero(~record.starts)
    rows = rows[(rows >= max(cause.onset, 1)) & (rows > _LAGS[-1])]
    if not isinstance(kind, NoiseKind) or not 0 < len(places) <= _FEW_BPMS or len(rows) < _FEWEST:
        return "", 0.0
    patterns = kind.patterns(record.layout)[:, places]
    if kind.target != "bpm" or np.any(np.count_nonzero(patterns, axis=0) != 1):
        return "", 0.0
    struck = np.argmax(patterns != 0.0, axis=0).tolist()
    others = [column for column in range(len(record.layout.bpms)) if column not in struck]
    usual = [gain for _, gain in _best(bench, rows, others[:: max(len(others) // _OTHERS, 1)])]
    found = [(words, gain - max(0.0, *usual)) for words, gain in _best(bench, rows, struck)]
    return max((("", 0.0), *found), key=lambda law: law[1])


def _best(bench: Bench, rows: Indices, columns: Sequence[int]) -> Iterator[tuple[str, float]]:
    """What drives each of some BPMs best, in words, and its gain less the price of the choice."""
    record = bench.record
    made = bench.currents @ record.layout.response.T
    for own in columns:
        reading, orbit = record.readings[:, own], bench.orbit[:, own]
        bent = [orbit**power for power in (2, 3)]
        beside = list(combinations(_of_its_cell(record.layout.bpms, own), 2))
        bent += [bench.orbit[:, one] * bench.orbit[:, other] for one, other in beside]
        steps = np.diff(np.column_stack([made, *bent]), axis=0, prepend=0.0)
        course = np.diff(reading - made[:, own], prepend=0.0)
        usual = _HEALTHY * float(np.std(steps[rows, own]))
        past = [its[rows - lag] for lag in _LAGS for its in (reading, orbit)]
        gains = _gains(course[rows], steps[rows], past, usual)
        best = int(np.argmax(gains))
        where = record.layout.bpms.label(own)
        if best < made.shape[1]:
            words = f"at {where} as what correctors do at {record.layout.bpms.label(best)}"
        elif best < made.shape[1] + 2:
            words = f"at {where} as what is not linear in the orbit there"
        else:
            pair = (record.layout.bpms.label(one) for one in beside[best - made.shape[1] - 2])
            words = f"at {where} as the product of what is read at {' and '.join(pair)}"
        price = float(np.log(steps.shape[1] * len(columns))) + _OCCAM
        yield words, float(gains[best]) - price


def _of_its_cell(bpms: Devices, own: int) -> list[int]:
    """Nearest BPMs of the cell and plane of one, with itself; none where no name tells a cell."""
    cell, plane = bpms.cells[own], bpms.planes[own]
    alike = zip(bpms.cells, bpms.planes, strict=True)
    found = [index for index, its in enumerate(alike) if cell and its == (cell, plane)]
    return sorted(sorted(found, key=lambda index: abs(index - own))[:_OF_A_CELL])


def _gains(course: Vector, drivers: Matrix, past: list[Vector], usual: float) -> Vector:
    """What each driver explains of a course beyond what is past, shape (D,) [nats].

    Args:
        course: Shape (K,) [m].
        drivers: Shape (K, D).
        past: Each of shape (K,).
        usual: Rms of what they explain in a healthy BPM, which does not count [m].
    """
    basis = np.linalg.qr(np.column_stack([np.ones(len(course)), *past]))[0]
    left = course - basis @ (basis.T @ course)
    moved = drivers - basis @ (basis.T @ drivers)
    size = np.sum(moved**2, axis=0) * float(left @ left)
    share = (left @ moved) ** 2 / np.maximum(size, 1e-300)
    rms = np.sqrt(share * float(np.mean(left**2)))
    beyond = np.maximum(1.0 - usual / np.maximum(rms, 1e-300), 0.0) ** 2
    return -0.5 * len(course) * beyond * np.log1p(-np.minimum(share, 1.0 - 1e-12))

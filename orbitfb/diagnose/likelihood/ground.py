"""Shapes that the walk of a healthy orbit may have: magnets that move, alone and together."""

import numpy as np

from orbitfb.effects.kicks import source_patterns
from orbitfb.estimation.floor import Shapes
from orbitfb.estimation.transform import Matrix
from orbitfb.records.layout import Layout

GIRDER = 3.0
"""Distance over which magnets of one girder move together [m]."""

SLAB = 20.0
"""Distance over which neighbouring girders move together, on one slab of concrete [m]."""


TOGETHER = 6
"""Quadrupoles in a row that may move as one body: a girder carries three to six of them."""


def ground_shapes(layout: Layout) -> Shapes:
    """Covariances of orbits that moving magnets make, each of any scale.

    Quadrupoles that move each alone; together over a girder and over a slab, for which the ring's
    places are needed; the dispersion's orbit, because ground that moves together changes the path
    length and, at a fixed radio frequency, the energy; BPMs that move themselves; and every row
    of quadrupoles that stand side by side, because nobody tells where girders begin and end, and
    some lie on worse ground than others.
    """
    count = len(layout.bpms)
    own = np.eye(count)
    ring = layout.ring
    if ring is None:
        spread = source_patterns(layout)
        return Shapes((_unit(spread @ spread.T), own), np.zeros((count, 0)))
    families: list[Matrix] = []
    rows: list[Matrix] = []
    place = ring.table.s[ring.places("QUAD")]
    around = float(ring.parameters.circumference)
    apart = np.abs(place[:, None] - place)
    apart = np.minimum(apart, around - apart)
    for plane in layout.planes:
        orbit = layout.orbit_per_kick("QUAD", plane)
        families.append(_unit(orbit @ orbit.T))
        families += [_unit(orbit @ np.exp(-apart / reach) @ orbit.T) for reach in (GIRDER, SLAB)]
        body = np.zeros_like(orbit)
        for length in range(TOGETHER):
            body = body + np.roll(orbit, -length, axis=1)
            rows.append(body)
    dispersion = layout.dispersion()
    if np.any(dispersion):
        families.append(_unit(np.outer(dispersion, dispersion)))
    single = np.hstack(rows)
    norm = np.linalg.norm(single, axis=0)
    return Shapes((*families, own), single[:, norm > 0.0] / norm[norm > 0.0])


def _unit(covariance: Matrix) -> Matrix:
    return covariance * (len(covariance) / float(np.trace(covariance)))

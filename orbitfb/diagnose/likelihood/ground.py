"""Shapes that the walk of a healthy orbit may have: magnets that move, alone and together."""

import numpy as np

from orbitfb.effects.kicks import source_patterns
from orbitfb.effects.layout import Layout
from orbitfb.estimation.transform import Matrix

GIRDER = 3.0
"""Distance over which magnets of one girder move together [m]."""

SLAB = 20.0
"""Distance over which neighbouring girders move together, on one slab of concrete [m]."""


def ground_families(layout: Layout) -> list[Matrix]:
    """Covariances of orbits that moving magnets make, each of any scale, shape (n, n).

    Quadrupoles that move each alone; together over a girder and over a slab, for which the ring's
    places are needed; the dispersion's orbit, because ground that moves together changes the path
    length and, at a fixed radio frequency, the energy; and BPMs that move themselves.
    """
    count = len(layout.bpms)
    own = np.eye(count)
    ring = layout.ring
    if ring is None:
        spread = source_patterns(layout)
        return [_unit(spread @ spread.T), own]
    families: list[Matrix] = []
    place = ring.table.s[ring.places("QUAD")]
    around = float(ring.parameters.circumference)
    apart = np.abs(place[:, None] - place)
    apart = np.minimum(apart, around - apart)
    for plane in layout.planes:
        orbit = layout.orbit_per_kick("QUAD", plane)
        families.append(_unit(orbit @ orbit.T))
        families += [_unit(orbit @ np.exp(-apart / reach) @ orbit.T) for reach in (GIRDER, SLAB)]
    dispersion = layout.dispersion()
    if np.any(dispersion):
        families.append(_unit(np.outer(dispersion, dispersion)))
    return [*families, own]


def _unit(covariance: Matrix) -> Matrix:
    return covariance * (len(covariance) / float(np.trace(covariance)))

"""Shapes that the walk of a healthy orbit may have: magnets that move, alone and together."""

import numpy as np

from orbitfb.effects.kicks import source_patterns
from orbitfb.estimation.priors import BODY, GIRDER, NEIGHBOURS, SITE, SLAB
from orbitfb.estimation.shapes import Shapes
from orbitfb.estimation.transform import Matrix
from orbitfb.records.layout import Layout


def ground_shapes(layout: Layout) -> Shapes:
    """Covariances of orbits that moving magnets make, each of any scale.

    Quadrupoles that move each alone; together over a girder, a slab and the site, for which the
    ring's places are needed; BPMs that move themselves; and every row of quadrupoles that stand
    side by side, because nobody tells where girders begin and end, and some lie on worse ground
    than others. A quadrupole that moves also changes the path length, and at a fixed radio
    frequency the energy: as far as that goes, so far does the energy of a healthy ring walk.
    """
    count = len(layout.bpms)
    own = np.eye(count)
    ring = layout.ring
    if ring is None:
        spread = source_patterns(layout)
        bumps = _unit(_bumps(layout))
        return Shapes((_unit(spread @ spread.T), bumps, own), np.zeros((count, 0)))
    families: list[Matrix] = []
    rows: list[Matrix] = []
    place = ring.table.s[ring.places("QUAD")]
    around = float(ring.parameters.circumference)
    apart = np.abs(place[:, None] - place)
    apart = np.minimum(apart, around - apart)
    for plane in layout.planes:
        orbit = layout.orbit_per_kick("QUAD", plane)
        if plane == "x":
            orbit = orbit + _by_energy(layout)
        families.append(_unit(orbit @ orbit.T))
        reaches = (GIRDER, SLAB, SITE)
        families += [_unit(orbit @ np.exp(-apart / reach) @ orbit.T) for reach in reaches]
        body = np.zeros_like(orbit)
        for length in range(BODY):
            body = body + np.roll(orbit, -length, axis=1)
            rows.append(body)
    single = np.hstack(rows)
    norm = np.linalg.norm(single, axis=0)
    return Shapes((*families, own), single[:, norm > 0.0] / norm[norm > 0.0])


def _bumps(layout: Layout) -> Matrix:
    """Covariance of orbits that neighbouring BPMs share, shape (n, n).

    What moves between two correctors makes an orbit that these make, too, all around the ring but
    for the BPMs near to it. Where these are is not known without places, but for their order.
    """
    planes = np.array(layout.bpms.planes)
    found = np.zeros((len(planes), len(planes)))
    for plane in layout.planes:
        own = np.flatnonzero(planes == plane)
        apart = np.abs(np.arange(len(own))[:, None] - np.arange(len(own)))
        apart = np.minimum(apart, len(own) - apart)
        found[np.ix_(own, own)] = np.exp(-apart / NEIGHBOURS)
    return found


def shaken_shapes(layout: Layout) -> Shapes:
    """Covariances of orbits that shake faster than they are read, each of any scale.

    Whatever kicks may shake alone (a vibrating magnet, a supply that ripples), all of them as much
    as each other, and the energy.
    """
    kicks = source_patterns(layout)
    single = kicks
    if layout.ring is not None:
        single = np.column_stack([kicks, np.nan_to_num(layout.dispersion())])
    norm = np.linalg.norm(single, axis=0)
    return Shapes((_unit(kicks @ kicks.T),), single[:, norm > 0.0] / norm[norm > 0.0])


def _by_energy(layout: Layout) -> Matrix:
    """Orbit that a kick makes by the energy it costs, shape (n, k) [m/rad].

    A kick θ where the dispersion is η lengthens the path by η θ; at a fixed radio frequency the
    energy gives way by δ = −η θ / (α_c C) (H. Wiedemann, Particle Accelerator Physics, ch. 8).
    """
    ring = layout.known_ring
    compaction = float(ring.parameters.alpha_c)
    if not compaction:
        return np.zeros((len(layout.bpms), len(ring.places("QUAD"))))
    eta = np.nan_to_num(ring.table.dispersion[ring.places("QUAD")])
    energy = -eta / (compaction * float(ring.parameters.circumference_m))
    return np.outer(np.nan_to_num(layout.dispersion()), energy)


def _unit(covariance: Matrix) -> Matrix:
    return covariance * (len(covariance) / float(np.trace(covariance)))

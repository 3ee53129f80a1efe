"""Shapes that the walk of a healthy orbit may have: magnets that move, alone and together."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import source_patterns
from orbitfb.estimation.priors import BODY, GIRDERS, NEIGHBOURS, SITE, SLAB
from orbitfb.estimation.shapes import Shapes
from orbitfb.estimation.transform import Indices, Matrix
from orbitfb.physics.places import Ring
from orbitfb.records.layout import Layout


def ground_shapes(layout: Layout) -> Shapes:
    """Covariances of orbits that moving magnets make, each of any scale.

    Quadrupoles move each alone, or with their girder, which heaves and tilts, or with the ground of
    a slab or the site, for which the ring's places are needed; BPMs move themselves. A magnet that
    moves kicks the beam in proportion to its strength; what else kicks there does not ask for it:
    both are laid out. Some stand on worse ground than others, and nobody tells where: every row of
    quadrupoles that stand side by side may have a walk of its own, if that is worth it.

    A quadrupole that moves also changes the path length, and at a fixed radio frequency the energy:
    as far as that goes where each moves alone, so far does the energy of a healthy ring walk. Where
    the whole ring breathes the energy wanders, which is an effect and no shape of the ground.
    """
    count = len(layout.bpms)
    own = np.eye(count)
    ring = layout.ring
    if ring is None:
        spread = source_patterns(layout)
        bumps = _unit(_bumps(layout))
        return Shapes((_unit(spread @ spread.T), bumps, own), np.zeros((count, 0)))
    quadrupoles = len(ring.places("QUAD"))
    moved = _together(ring)
    families: list[Matrix] = []
    rows: list[Matrix] = []
    for plane in layout.planes:
        orbit = layout.orbit_per_kick("QUAD", plane)
        alone = orbit + _by_energy(layout) if plane == "x" else orbit
        for size in (1.0, np.nan_to_num(ring.strength("QUAD"))):
            each, all_at_once = alone * size, orbit * size
            found = [each @ each.T, *(all_at_once @ among @ all_at_once.T for among in moved)]
            families += [_unit(one) for one in found if np.any(one)]
        body = np.zeros_like(orbit)
        for length in range(BODY):
            body = body + np.roll(orbit, -length, axis=1)
            rows.append(body)
    single = np.hstack(rows)
    norm = np.linalg.norm(single, axis=0)
    single = single[:, norm > 0.0] / norm[norm > 0.0]
    return Shapes((*families, own), single, quadrupoles * len(layout.planes))


def _together(ring: Ring) -> list[Matrix]:
    """How quadrupoles move with each other, by what they stand on, shape (q, q) each.

    Of slab and site without what all have in common.
    """
    place = ring.table.s[ring.places("QUAD")]
    around = float(ring.parameters.circumference)
    apart = np.abs(place[:, None] - place)
    apart = np.minimum(apart, around - apart)
    apart_from_all = np.eye(len(place)) - 1.0 / len(place)
    found = [apart_from_all @ np.exp(-apart / one) @ apart_from_all for one in (SLAB, SITE)]
    known: set[tuple[int, ...]] = set()
    for gap in GIRDERS:
        girder, arm = _girders(place, around, gap)
        if tuple(girder) in known or not 1 < len(set(girder)) < len(place):
            continue
        known.add(tuple(girder))
        same = (girder[:, None] == girder).astype(float)
        found += [same, np.outer(arm, arm) * same]
    return found


def _girders(place: Vector, around: float, gap: float) -> tuple[Indices, Vector]:
    """Girders that end where a gap is wider, by quadrupole, and where it stands on its own [m].

    Args:
        place: Of the quadrupoles, in order, shape (q,) [m].
        around: Circumference [m].
        gap: Widest between neighbours on one girder [m].
    """
    wide = np.diff(place) > gap
    girder = np.concatenate([[0], np.cumsum(wide)])
    along = place.copy()
    if place[0] + around - place[-1] <= gap:  # one girder stands where the ring begins
        last = girder == girder[-1]
        along[last] -= around
        girder[last] = 0
    mean = np.bincount(girder, along) / np.bincount(girder)
    return girder, along - mean[girder]


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

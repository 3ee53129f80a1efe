"""Places between the devices: the orbits that their kicks make, and the orbit that they see."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices, Kind
from orbitfb.records.layout import ChannelPlane, Layout
from orbitfb.records.record import Record

_UNRESOLVED = 1e-5
"""Share of the orbit's variance that the interpolation takes for noise."""

CALIBRATION = 5e-5
"""Kick per ampere that is assumed of correctors that are in no table [rad/A]."""

_KICKING: tuple[Kind, ...] = ("QUAD", "COR")

_LONG = 3.0
"""Distance of two quadrupoles from which something may stand between them that no table of places
has [m]: insertion devices and bending magnets are one to seven metres long. By hand."""

NO_RING = "needs a places table that knows the names of the record"


def needs_ring(record: Record, planes: Sequence[ChannelPlane] = ()) -> str:
    """Say why a record has no optics, or lacks a plane; empty when it has all.

    Args:
        record: The record.
        planes: That must have BPMs.
    """
    if record.layout.ring is None:
        return NO_RING
    missing = [plane for plane in planes if plane not in record.layout.planes]
    return f"needs BPMs in {' and '.join(missing)}" if missing else ""


@lru_cache(maxsize=8)
def source_names(layout: Layout) -> tuple[str, ...]:
    """Names of all places that may kick, plane by plane.

    These are quadrupoles, correctors, and the middles of straights, which are called by the
    quadrupoles at their ends (`QL1B_C16 to QL1A_C17`): insertion devices and bending magnets are in
    no table. In a ring that is not known these are the columns of the correctors: what kicks stands
    among them.
    """
    ring = layout.ring
    if ring is None:
        correctors = layout.correctors
        return tuple(correctors.label(column) for column in range(len(correctors)))
    quads = ring.names("QUAD")
    between = [f"{quads[first]} to {quads[last]}" for first, last in straights(layout)]
    names = (*quads, *ring.names("COR"), *between)
    return tuple(f"{name} ({plane})" for plane in layout.planes for name in names)


def source_patterns(layout: Layout) -> Matrix:
    """Orbit per kick at the places of `source_names`, shape (n, P) [m/rad].

    What correctors of an unknown ring kick per ampere is not known: kicks are told as if it were
    `CALIBRATION`.
    """
    if layout.ring is None:
        return layout.response / CALIBRATION
    parts: list[Matrix] = []
    for plane in layout.planes:
        parts += [layout.orbit_per_kick(kind, plane) for kind in _KICKING]
        parts.append(kicks_between(layout, straights(layout), 0.5, plane))
    return np.hstack(parts)


@lru_cache(maxsize=8)
def displacing_names(layout: Layout) -> tuple[str, ...]:
    """Names of the straights whose devices may displace the beam, plane by plane.

    In a ring that is not known there are none.
    """
    if layout.ring is None:
        return ()
    quads = layout.ring.names("QUAD")
    between = [f"{quads[first]} against {quads[last]}" for first, last in straights(layout)]
    return tuple(f"{name} ({plane})" for plane in layout.planes for name in between)


def displacing_patterns(layout: Layout) -> Matrix:
    """Orbit per kick at the first end of a straight and against it at the last, (n, P) [m/rad].

    It leaves the angle as it was and displaces the beam: the second field integral of a device, as
    the kick in the middle of `source_patterns` is the first one.
    """
    parts: list[Matrix] = [np.zeros((len(layout.bpms), 0))]
    if layout.ring is not None:
        first, last = np.array(straights(layout), dtype=np.intp).reshape(-1, 2).T
        for plane in layout.planes:
            per_kick = layout.orbit_per_kick("QUAD", plane)
            parts.append(per_kick[:, first] - per_kick[:, last])
    return np.hstack(parts)


@lru_cache(maxsize=8)
def straights(layout: Layout) -> tuple[tuple[int, int], ...]:
    """Numbers of the quadrupoles at the ends of every straight that is long, in ring order."""
    ring = layout.known_ring
    place = ring.table.s[ring.places("QUAD")]
    order = np.argsort(place)
    after = np.roll(order, -1)
    apart = (place[after] - place[order]) % float(ring.parameters.circumference)
    pairs = zip(order[apart > _LONG], after[apart > _LONG], strict=True)
    return tuple((int(first), int(last)) for first, last in pairs)


def kicks_between(
    layout: Layout, pairs: Sequence[tuple[int, int]], share: float, plane: ChannelPlane
) -> Matrix:
    """Orbit per kick at places between quadrupoles with nothing but drift from one to the other.

    Beyond the two a kick θ is what kicks (1 − s) θ and s θ at them are, s the share of the way:
    they make the same angle and the same displacement there. Between them the orbit bends where the
    kick is.

    Args:
        layout: Devices and ring.
        pairs: Numbers of the quadrupoles.
        share: Of the way from the first to the second, s [1].
        plane: Of the kick.

    Returns:
        Shape (n, len(pairs)) [m/rad]; zero for BPMs of the other plane.
    """
    if not pairs:
        return np.zeros((len(layout.bpms), 0))
    ring = layout.known_ring
    around = float(ring.parameters.circumference)
    per_kick = layout.orbit_per_kick("QUAD", plane)
    first, last = (np.array(one, dtype=np.intp) for one in zip(*pairs, strict=True))
    orbit = (1.0 - share) * per_kick[:, first] + share * per_kick[:, last]
    place = ring.table.s[ring.places("QUAD")]
    position = dict(zip(ring.table.name, ring.table.s.tolist(), strict=True))
    length = (place[last] - place[first]) % around
    for row in layout.bpms.in_plane(plane):
        since = (position[layout.bpms.names[row]] - place[first]) % around
        bent = np.maximum(since - share * length, 0.0) - (1.0 - share) * since
        orbit[row] += np.where(since < length, bent, 0.0)
    return orbit


def two_planes(layout: Layout, kind: Kind) -> Matrix:
    """Orbit per kick of places that act in both planes, rows of x and of y BPMs, shape (n, P)."""
    total = np.zeros((len(layout.bpms), len(layout.known_ring.places(kind))))
    for plane in layout.planes:
        total += layout.orbit_per_kick(kind, plane)
    return total


@lru_cache(maxsize=8)
def interpolation(layout: Layout, kind: Kind, plane: ChannelPlane) -> Matrix:
    """Tell the orbit at places from the orbit at the BPMs, where only quadrupoles kick between.

    The most likely orbit if all quadrupoles stand aside by the same random amount (N. Wiener's
    filter in space). On the default ring it is right to 0.3 % of the orbit.

    Args:
        layout: Devices and ring.
        kind: Of the places.
        plane: Of the orbit.

    Returns:
        Shape (k, n); zero for BPMs of the other plane [m/m]. Computed once, not to be written to.
    """
    ring = layout.known_ring
    strength = np.nan_to_num(ring.strength("QUAD"))
    if not np.any(strength):
        strength = np.ones_like(strength)
    places = ring.places(kind)
    columns = layout.bpms.in_plane(plane)
    found = np.zeros((len(places), len(layout.bpms)))
    if not len(columns):
        return found
    at_bpms = layout.orbit_per_kick("QUAD", plane)[columns] * strength
    at_places = green(ring, places, "QUAD", plane) * strength
    spread = at_bpms @ at_bpms.T
    spread += _UNRESOLVED * np.trace(spread) / len(columns) * np.eye(len(columns))
    found[:, columns] = np.linalg.solve(spread, at_bpms @ at_places.T).T
    found.setflags(write=False)
    return found


class Moved(Effect):
    """An orbit of fixed shape that follows a course in time.

    Args:
        shape: Orbit per unit of the course, shape (n,).
        course: The course, by tick.
    """

    def __init__(self, shape: Vector, course: Callable[[int], float]) -> None:
        self._shape, self._course = shape, course

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add it."""
        return orbit + self._course(tick) * self._shape


def together(patterns: Matrix, places: Indices) -> Vector:
    """Orbit of unit amplitudes at several places, shape (n,)."""
    return patterns[:, places].sum(axis=1)

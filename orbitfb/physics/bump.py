"""Closed bumps: the orbit moves at one place of the ring, and nowhere else.

Position and angle at a source follow from the optics at two neighbouring places of the table with
nothing but a drift between them: with x_A and x_B there and L from one to the other,

    x(s) = x_A + (s − s_A) x',    x' = (x_B − x_A) / L.

Between two such places the transfer matrix has M12 = sqrt(β_A β_B) sin(φ_B − φ_A) = L in both
planes (Courant and Snyder, Ann. Phys. 3 (1958), eq. 3.6 with α eliminated); a lens between them
changes it with opposite signs in x and y. Where no drift lies beside a place, only the position is
known there.

The kicks are those of the nearest correctors on either side that leave the BPMs beyond them where
they are and give position and angle; of all that do, the smallest.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import green
from orbitfb.physics.places import Indices, Plane, Ring

A_SIDE = 3
"""Correctors on either side. Two close a bump of position and angle in y; in x the energy that they
change is a further condition, so that it takes five."""
DRIFT = 1e-3
"""Relative difference of M12 and L up to which a segment is a drift: the angle is wrong by no more.
Drifts of the default table differ by 1e-10, its magnets by 1.4e-3 (a dipole) to 3e-2."""
LEAK = 0.01
"""Largest rms orbit beyond the correctors, and error at the source, relative to the bump."""
HERE = 1e-6
"""How close to a place of the table a source is at that place [m]."""
_RANK = 1e-10
_BEYOND = 3
"""BPMs beyond the correctors that it takes to say that a bump is closed: a closed orbit has three
degrees of freedom where nobody kicks, two of betatron motion and the energy."""


@dataclass(frozen=True, slots=True)
class Source:
    """A place at which the orbit is to be moved.

    Args:
        name: As operators say.
        s: Where it is [m].
        ends: Indices into the table: two with a drift between them, one after the other; or one
            place twice, where only the position is known.
        length: From one to the other [m]; 0 for one place.
        share: Part of that length from the first one to the source, 0 to 1.
    """

    name: str
    s: float
    ends: tuple[int, int]
    length: float
    share: float

    @property
    def has_angle(self) -> bool:
        """Whether the angle is known there."""
        return self.length > 0.0


@dataclass(frozen=True, slots=True)
class Bump:
    """A closed bump of one plane.

    Args:
        kicks: Of the correctors, shape (m,) [rad].
        orbit: At the BPMs, shape (n,) [m]; 0 beyond the correctors that make it.
    """

    kicks: Vector
    orbit: Vector


def find_source(ring: Ring, name: str) -> Source:
    """Find a source.

    Args:
        ring: The ring.
        name: A place of the table, two of them with a comma (the middle between them), or a
            position s [m].

    Raises:
        RingError: There is no such place, or nothing is known there.
    """
    table, round_ = ring.table, ring.parameters.circumference
    parts = [part.strip() for part in name.split(",")]
    if len(parts) == 1 and parts[0] in table.name:
        return _at_place(ring, name, table.name.index(parts[0]))
    if len(parts) == 2 and all(part in table.name for part in parts):
        first, second = (table.s[table.name.index(part)] for part in parts)
        half = ((second - first + round_ / 2) % round_ - round_ / 2) / 2
        return _at(ring, name, float((first + half) % round_))
    try:
        s = float(name)
    except ValueError:
        unknown = [part for part in parts if part not in table.name]
        hint = did_you_mean(unknown[0], table.name) if unknown else ""
        raise RingError(
            f"no source {name!r}{hint}; give a place of the table, two of them as in "
            '"A,B" for the middle between them, or a position s [m]'
        ) from None
    if not 0.0 <= s < round_:
        raise RingError(f"s = {s:g} m is not on the ring, that is {round_:g} m long")
    return _at(ring, name, s)


def closed_bump(
    ring: Ring,
    plane: Plane,
    source: Source,
    position: float,
    angle: float = 0.0,
    movable: Mask | None = None,
) -> Bump:
    """Make a bump.

    Args:
        ring: The ring.
        plane: x or y.
        source: Where the orbit is to be moved.
        position: By how much [m].
        angle: Change of its slope [rad]; 0 where it is not known (`Source.has_angle`).
        movable: Correctors that may be used, shape (m,); None: all.

    Raises:
        RingError: The angle is not known there, or these correctors make no closed bump.
    """
    if angle and not source.has_angle:
        raise RingError(
            f"the angle at {source.name} is not known: on neither side is there a drift up to the "
            "next place of the table; ask for the position alone, or for a place in a drift"
        )
    correctors, bpms = ring.places("COR", plane), ring.places("BPM", plane)
    used, inside = _around(ring, source, correctors, bpms, movable)
    beyond = bpms[~inside]
    if len(beyond) < _BEYOND or len(used) < 4:
        raise RingError(
            f"{len(used)} correctors around {source.name} leave {len(beyond)} BPMs beyond them; a "
            f"closed bump takes at least 4 correctors and {_BEYOND} BPMs that stay"
        )
    sources = correctors[used]
    first, second = green(ring, np.array(source.ends), sources, plane)
    rows, wanted = [(1.0 - source.share) * first + source.share * second], [position]
    if source.has_angle:
        rows.append((second - first) / source.length)
        wanted.append(angle)
    out = green(ring, beyond, sources, plane)
    conditions = np.vstack([out, *rows])
    aim = np.concatenate([np.zeros(len(out)), wanted])
    kicks = np.asarray(np.linalg.lstsq(conditions, aim, rcond=_RANK)[0], dtype=np.float64)
    orbit = np.where(inside, green(ring, "BPM", sources, plane) @ kicks, 0.0)
    _check(source, conditions @ kicks - aim, len(out), orbit, (position, angle))
    whole = np.zeros(len(correctors))
    whole[used] = kicks
    return Bump(whole, orbit)


def _check(
    source: Source, errors: Vector, beyond: int, orbit: Vector, wanted: tuple[float, float]
) -> None:
    """Refuse a bump that is not closed, or is not what was asked for."""
    size = max(float(np.abs(orbit).max(initial=0.0)), abs(wanted[0]))
    leak = float(np.sqrt(np.mean(errors[:beyond] ** 2)))
    missed = abs(errors[beyond]) > LEAK * size
    if source.has_angle:
        missed |= abs(errors[beyond + 1]) > LEAK * max(abs(wanted[1]), size / source.length)
    if leak > LEAK * size or missed:
        raise RingError(
            f"the correctors around {source.name} make no closed bump of {wanted[0] * 1e6:g} µm, "
            f"{wanted[1] * 1e6:g} µrad: {leak * 1e6:.3g} µm rms would be left elsewhere; more "
            "correctors must be enabled around it"
        )


def _around(
    ring: Ring, source: Source, correctors: Indices, bpms: Indices, movable: Mask | None
) -> tuple[Indices, Mask]:
    """Give the correctors that make a bump, and the BPMs between the outermost of them, (n,)."""
    table, round_ = ring.table, ring.parameters.circumference
    may = np.ones(len(correctors), dtype=np.bool_) if movable is None else movable
    order = np.flatnonzero(may)
    ahead = (table.s[correctors[order]] - source.s) % round_
    order, ahead = order[np.argsort(ahead)], np.sort(ahead)
    if len(order) <= 2 * A_SIDE:
        return order, np.ones(len(bpms), dtype=np.bool_)
    used = np.concatenate([order[-A_SIDE:], order[:A_SIDE]])
    last, first = ahead[A_SIDE - 1], ahead[-A_SIDE]
    where = (table.s[bpms] - source.s) % round_
    return used, (where < last) | (where > first)


def _at(ring: Ring, name: str, s: float) -> Source:
    table, round_ = ring.table, ring.parameters.circumference
    near = np.abs((table.s - s + round_ / 2) % round_ - round_ / 2)
    if near.min() <= HERE:
        return _at_place(ring, name, int(near.argmin()))
    after = int(np.searchsorted(table.s, s)) % len(table.s)
    before = (after - 1) % len(table.s)
    length = _drift(ring, before, after)
    if length == 0.0:
        raise RingError(
            f"{name}: between {table.name[before]} and {table.name[after]} lies a magnet, so that "
            "the orbit there does not follow from that at these two; give one of them, or a "
            "place in a drift"
        )
    share = float((s - table.s[before]) % round_ / length)
    return Source(name, s, (before, after), length, share)


def _at_place(ring: Ring, name: str, index: int) -> Source:
    table = ring.table
    count, s = len(table.s), float(table.s[index])
    if table.kind[index] != "COR":  # there the angle before is not the one after
        for before, after, share in (
            ((index - 1) % count, index, 1.0),
            (index, (index + 1) % count, 0.0),
        ):
            if length := _drift(ring, before, after):
                return Source(name, s, (before, after), length, share)
    return Source(name, s, (index, index), 0.0, 0.0)


def _drift(ring: Ring, before: int, after: int) -> float:
    """Give the length of the drift from a place to the next one [m]; 0: it is none."""
    table, parameters = ring.table, ring.parameters
    length = float((table.s[after] - table.s[before]) % parameters.circumference)
    turn = 0.0 if after > before else 2 * np.pi
    tunes = np.array([ring.tune("x"), ring.tune("y")])
    advance = table.phase[:, after] - table.phase[:, before] + turn * tunes
    transfer = np.sqrt(table.beta[:, before] * table.beta[:, after]) * np.sin(advance)
    is_drift = length > 0.0 and bool((np.abs(transfer - length) <= DRIFT * length).all())
    return length if is_drift else 0.0

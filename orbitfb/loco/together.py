"""Findings that are one thing to look at are told as one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.loco.named import Named

_ONE_TURN = 0.1
"""How far two readings of a BPM may see of each other unequally, of their sum, and it is a turn:
their gains, of some per cent, are not the same [1]."""

_MANY = 4
"""Rows, or columns, of a plane from which those whose phases are off the same way are one finding:
of three one in four has one sign by chance."""

_MOST_TOLD = 6


def in_order(named: Sequence[Named]) -> list[Named]:
    """Sort: what stands out before what may, the surest first."""
    return sorted(named, key=lambda its: (not its.stands_out, -its.z))


def rows_together(named: Sequence[Named]) -> list[Named]:
    """Tell rows or columns of one plane whose phases are off the same way as one finding."""
    groups: dict[tuple[str, str, bool], list[Named]] = {}
    for its in named:
        if its.kind in ("bpm-row", "corrector-column") and its.unit == "rad" and its.stands_out:
            plane = its.places[0].rpartition(":")[2]
            groups.setdefault((its.kind, plane, its.value > 0), []).append(its)
    found = list(named)
    for (kind, plane, _), members in groups.items():
        if len(members) >= _MANY:
            members = in_order(members)
            found = [its for its in found if its not in members]
            found.append(_rows(kind, plane, members))
    return found


def _rows(kind: str, plane: str, members: list[Named]) -> Named:
    what = "rows of BPMs" if kind == "bpm-row" else "columns of correctors"
    sizes = [f"{its.places[0]} {1e3 * its.value:+.3g}" for its in members[:_MOST_TOLD]]
    more = len(members) - len(sizes)
    text = (
        f"{len(members)} {what} in {plane} are not of this lattice: their betatron phases are off "
        f"the same way [mrad]: {', '.join(sizes)}{f' and {more} more' if more else ''}. So many "
        "have one cause: the optics of the table between there and their neighbours, or where it "
        "has them."
    )
    return replace(members[0], places=tuple(its.places[0] for its in members), text=text)


def as_turns(named: Sequence[Named]) -> list[Named]:
    """Tell both readings of one BPM that see as much of each other, with opposite signs, as one."""
    found = list(named)
    rolls = {its.places[0]: its for its in named if its.kind == "bpm-roll"}
    for place, x in rolls.items():
        name, _, plane = place.rpartition(":")
        y = rolls.get(f"{name}:y")
        if plane != "x" or y is None or abs(x.value + y.value) > _ONE_TURN * abs(x.value - y.value):
            continue
        weight = np.array([x.sigma, y.sigma]) ** -2.0
        angle = float(np.average([x.value, -y.value], weights=weight))
        text = f"BPM {name} is turned by {angle:+.3g} rad about the beam."
        best = max(x, y, key=lambda its: its.z)
        turn = replace(
            best, places=(name,), value=angle, sigma=float(weight.sum() ** -0.5), text=text
        )
        found = [its for its in found if its not in (x, y)] + [turn]
    return found


def without_echoes(named: Sequence[Named]) -> list[Named]:
    """Leave out what is named twice: a row by its phase and by its shape, or that is dead."""
    seen: set[tuple[str, tuple[str, ...]]] = set()
    dead = {place for its in named if its.kind.endswith("dead") for place in its.places}
    kept: list[Named] = []
    for its in sorted(named, key=lambda one: one.unit == "m/rad"):
        key = (its.kind, its.places)
        echo = its.kind in ("bpm-row", "corrector-column") and its.places[0] in dead
        if key not in seen and not echo:
            kept.append(its)
            seen.add(key)
    return kept

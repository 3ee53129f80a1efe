"""The table of PVs for the docs, made from the layout that serves them."""

from collections.abc import Sequence
from dataclasses import dataclass

from orbitfb.core.names import CURRENT_PV, RF_PV, RF_READBACK_PV
from orbitfb.physics.places import Planes, Ring
from orbitfb.sim.layout import (
    KICK_PV,
    STORED_PV,
    TICK_PV,
    TRUE_RMS_PV,
    PvSpec,
    Range,
    lay_out,
)
from orbitfb.sim.settings import SimSettings

_SINGLE = {
    CURRENT_PV: "stored current",
    RF_PV: "RF frequency: setpoint; it moves the beam in plane x",
    RF_READBACK_PV: "RF frequency: readback",
    TRUE_RMS_PV: "rms of the true orbit (simulator only)",
    TICK_PV: "count of ticks (simulator only)",
    KICK_PV: "kick the beam: rms of a random orbit step (simulator only)",
    STORED_PV: "stored current to have (simulator only)",
}


@dataclass(frozen=True, slots=True)
class PvFamily:
    """PVs of one kind.

    Args:
        meaning: What they are, in a few words.
        specs: The PVs, in the order of the vectors.
        written: Whether clients may write them.
    """

    meaning: str
    specs: tuple[PvSpec, ...]
    written: bool


def pv_families(ring: Ring, planes: Planes, settings: SimSettings) -> tuple[PvFamily, ...]:
    """Sort every PV that the soft IOC serves into families.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: Of the soft IOC.
    """
    channels = ring.channels(planes)
    layout = lay_out(channels, settings)
    families: list[PvFamily] = []
    readings = list(layout.readings)
    readbacks = list(_take(readings, sum(map(bool, channels.readback_pvs))))
    for plane, part in channels.bpm_parts.items():
        own = _take(readings, part.stop - part.start)
        families.append(PvFamily(f"BPM reading, {plane}", own, False))
    for plane, part in channels.corrector_parts.items():
        families.append(PvFamily(f"corrector setpoint, {plane}", layout.setpoints[part], True))
    for plane, part in channels.corrector_parts.items():
        own = _take(readbacks, sum(map(bool, channels.readback_pvs[part])))
        families.append(PvFamily(f"corrector readback, {plane}", own, False))
    families.append(PvFamily(_SINGLE[RF_PV], layout.setpoints[-1:], True))
    families += [PvFamily(_SINGLE[spec.name], (spec,), False) for spec in readings]
    families += [PvFamily(_SINGLE[spec.name], (spec,), True) for spec in layout.knobs]
    return tuple(families)


def pv_table_markdown(ring: Ring, planes: Planes, settings: SimSettings) -> str:
    """Write the families as a table.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.
        settings: Of the soft IOC.
    """
    rows = [
        "| what | first PV | count | unit | digits | clients | writes allowed | "
        "MINOR alarm | MAJOR alarm |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for family in pv_families(ring, planes, settings):
        first = family.specs[0]
        rows.append(
            "| "
            + " | ".join(
                (
                    family.meaning,
                    f"`{first.name}`",
                    str(len(family.specs)),
                    first.units or "1",
                    str(first.precision),
                    "read, write" if family.written else "read",
                    _between(first.drive) if family.written else "never",
                    _beyond(first.warning),
                    _beyond(first.alarm),
                )
            )
            + " |"
        )
    return "\n".join(rows) + "\n"


def _take(specs: list[PvSpec], count: int) -> tuple[PvSpec, ...]:
    """Take the first ones off a list."""
    taken = tuple(specs[:count])
    del specs[:count]
    return taken


def count_pvs(families: Sequence[PvFamily]) -> int:
    """Count the PVs of all families."""
    return sum(len(family.specs) for family in families)


def _between(limits: Range) -> str:
    return f"{limits[0]:g} to {limits[1]:g}"


def _beyond(limits: Range) -> str:
    return "" if limits[0] == limits[1] else f"≤ {limits[0]:g}, ≥ {limits[1]:g}"

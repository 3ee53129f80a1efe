"""Which devices an effect is on: from cells, names and planes to columns and places."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import ConfigError
from orbitfb.core.near_names import did_you_mean
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.effects.settings import EffectSettings
from orbitfb.physics.places import Indices, Plane
from orbitfb.records.cells import cell_of
from orbitfb.records.layout import Devices, Layout

_WITH_PLANE = re.compile(r"(.*?)\s*\(([xy])\)")
_RANGE = re.compile(r"([^-]+?)\s*-\s*([^-]+)")


@dataclass(frozen=True, slots=True)
class _Candidates:
    """Where an effect may be.

    Args:
        what: For messages: "BPMs", …
        names: Of the devices.
        planes: `x`, `y`, or empty where a device is in no plane.
        cells: Empty where not known.
    """

    what: str
    names: tuple[str, ...]
    planes: tuple[str, ...]
    cells: tuple[str, ...]


def resolve(settings: EffectSettings, layout: Layout) -> Indices:
    """Find the places that an effect's settings name, as `EffectKind.simulate` wants them.

    Args:
        settings: Of the effect.
        layout: Of the ring.

    Raises:
        ConfigError: Nothing is there, or not what was named.
    """
    kind = settings.kind
    if kind.target == "ring":
        if settings.cells or settings.names or settings.planes != "xy":
            raise ConfigError(
                f"effect {kind.id}: it is on the whole ring; leave out cells, names and planes"
            )
        return np.zeros(0, dtype=np.intp)
    there = _candidates(kind, layout)
    chosen = np.array([not p or p in settings.planes for p in there.planes], dtype=np.bool_)
    if settings.planes != "xy" and not any(there.planes):
        raise ConfigError(f"effect {kind.id}: {there.what} are in no plane; leave out planes")
    if settings.names:
        found = _by_names(settings, there, _devices_of_pvs(kind, layout))
    elif settings.cells:
        found = _by_cells(settings, there)
    else:
        found = np.arange(len(there.names), dtype=np.intp)
    found = found[chosen[found]]
    if not len(found):
        raise ConfigError(
            f"effect {kind.id}: no {there.what} are left in planes {settings.planes} of "
            f"{settings.text}; this ring is simulated in {'+'.join(layout.planes)}"
        )
    return _couple(kind, layout, found, there) if isinstance(kind, PairKind) else found


def names_for(kind: EffectKind, layout: Layout) -> tuple[str, ...]:
    """Give the names that an effect may be on, in the order of the ring; one for each plane."""
    return _candidates(kind, layout).names


def _couple(kind: PairKind, layout: Layout, found: Indices, there: _Candidates) -> Indices:
    """Order columns so that neighbours are the pairs: by device, or plane by plane."""
    by_plane = np.array(sorted(found.tolist(), key=lambda i: there.planes[i]), dtype=np.intp)
    pairs = np.sort(kind.pairs(layout), axis=1)
    tied = set(map(tuple, pairs.tolist()))
    couples = np.sort(by_plane[: len(found) // 2 * 2].reshape(-1, 2), axis=1)
    fits = all(tuple(couple) in tied for couple in couples.tolist())
    return by_plane if fits else found


def _candidates(kind: EffectKind, layout: Layout) -> _Candidates:
    if kind.target == "bpm":
        return _of_devices("BPMs", layout.bpms)
    if kind.target == "corrector":
        return _of_devices("correctors", layout.correctors)
    if kind.target == "quadrupole":
        return _of_names("quadrupoles", layout.known_ring.names("QUAD"))
    if kind.target == "sextupole":
        return _of_names("sextupoles", layout.known_ring.names("SEXT"))
    if isinstance(kind, SourceKind | NoiseKind):
        return _of_names("places", kind.places_of(layout))
    raise ConfigError(f"effect {kind.id}: it does not tell which places it may have")


def _devices_of_pvs(kind: EffectKind, layout: Layout) -> dict[str, tuple[str, Plane]]:
    if layout.ring is None or kind.target not in ("bpm", "corrector"):
        return {}
    return layout.ring.devices_of_pvs("BPM" if kind.target == "bpm" else "COR")


def _of_devices(what: str, devices: Devices) -> _Candidates:
    return _Candidates(what, devices.names, devices.planes, devices.cells)


def _of_names(what: str, labels: Sequence[str]) -> _Candidates:
    parts = [_WITH_PLANE.fullmatch(label) for label in labels]
    names = tuple(p[1] if p else label for p, label in zip(parts, labels, strict=True))
    planes = tuple(p[2] if p else "" for p in parts)
    return _Candidates(what, names, planes, tuple(map(cell_of, names)))


def _by_names(
    settings: EffectSettings, there: _Candidates, pvs: Mapping[str, tuple[str, Plane]]
) -> Indices:
    found: list[int] = []
    for name in settings.names:
        part = _WITH_PLANE.fullmatch(name)
        device, plane = pvs.get(name) or ((part[1], part[2]) if part else (name, ""))
        hits = [
            index
            for index, its in enumerate(there.names)
            if its == device and (not plane or there.planes[index] == plane)
        ]
        if not hits:
            hint = did_you_mean(name, (*there.names, *pvs)) or _some(there.names)
            raise ConfigError(
                f"effect {settings.id}, names: the ring has no {there.what} called {name!r}{hint}; "
                "devices of another ring need its places table (ring.places of the configuration)"
            )
        found += hits
    return np.array(list(dict.fromkeys(found)), dtype=np.intp)


def _some(names: Sequence[str]) -> str:
    """Show what names look like where none is like the one that was typed."""
    distinct = list(dict.fromkeys(names))
    return f"; {len(distinct)} there are, {', '.join(distinct[:3])} for some"


def _by_cells(settings: EffectSettings, there: _Candidates) -> Indices:
    order = list(dict.fromkeys(filter(None, there.cells)))
    wanted: set[str] = set()
    for word in settings.cells:
        wanted |= set(_cells(word, order, settings.id, there.what))
    return np.array([i for i, cell in enumerate(there.cells) if cell in wanted], dtype=np.intp)


def _cells(word: str, order: list[str], name: str, what: str) -> list[str]:
    """Cells that a word means; a range goes along the ring and may pass its beginning."""
    one = _cell(word, order)
    if one:
        return [one]
    ends = _RANGE.fullmatch(word)
    first, last = (_cell(ends[1], order), _cell(ends[2], order)) if ends else ("", "")
    if not first or not last:
        told = f"{order[0]} to {order[-1]}" if order else "none that the names tell"
        raise ConfigError(
            f"effect {name}, cells: {word!r} is no cell with {what}, nor a range FIRST-LAST; "
            f"the cells are {told}"
        )
    begin, end = order.index(first), order.index(last)
    return order[begin : end + 1] if begin <= end else order[begin:] + order[: end + 1]


def _cell(word: str, order: list[str]) -> str:
    """A cell by its name or its number; empty when there is none."""
    if word in order:
        return word
    number = re.fullmatch(r"C?0*(\d+)", word)
    wanted = number and int(number[1])
    hits = (cell for cell in order if (d := re.search(r"\d+$", cell)) and int(d[0]) == wanted)
    return next(hits, "") if number else ""

"""From the names of a record to devices: which plane, which ring."""

import difflib
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices, Kind, Plane, Planes, Ring
from orbitfb.records.devices import devices_of
from orbitfb.records.finding import Finding
from orbitfb.records.layout import ChannelPlane, Devices
from orbitfb.records.reading.metadata import Meta
from orbitfb.records.reading.raw import Raw

_SUFFIX = re.compile(r"(.*[^:_./\s-])[:_./\s-]([xyhv])", re.IGNORECASE)
_PLANE_OF_LETTER: dict[str, ChannelPlane] = {"x": "x", "h": "x", "y": "y", "v": "y"}
_KINDS: dict[str, Kind] = {"bpm_names": "BPM", "corr_names": "COR"}
_MOSTLY = 0.5


@dataclass(frozen=True, slots=True)
class Named:
    """Names behind columns.

    Args:
        array: Name of the array that they came in.
        names: Without a plane's suffix.
        planes: Of every column; empty while nobody knows.
        channels: PVs that stood there instead of the names; empty otherwise.
    """

    array: str
    names: tuple[str, ...]
    planes: tuple[ChannelPlane, ...]
    channels: tuple[str, ...] = ()

    def only(self, plane: ChannelPlane) -> "Named":
        """Keep the columns of one plane."""
        kept = [i for i, its in enumerate(self.planes) if its == plane]
        return Named(self.array, tuple(self.names[i] for i in kept), (plane,) * len(kept))

    def devices(self, columns: Indices) -> Devices:
        """The devices behind some columns, once their planes are known."""
        return devices_of(self.names, self.planes, self.channels).only(columns)


def plain_names(raw: Raw, array: str, count: int, told: tuple[str, ...], ring: Ring) -> Named:
    """Read names, and what they themselves tell of planes.

    Args:
        raw: The arrays.
        array: `bpm_names` or `corr_names`.
        count: Columns that there are.
        told: Plane of every column if `meta` says so, else empty.
        ring: Whose names are never taken apart.

    Raises:
        RecordError: There are too few or too many, or one is empty or not printable.
    """
    names = tuple(name.strip() for name in raw.texts[array])
    if len(names) != count:
        raise raw.wrong(array, f"has {len(names)} names for {count} columns", "name every column")
    for row, name in enumerate(names):
        if not name or not name.isprintable():
            raise raw.wrong(array, f"row {row} is {name!r}, no name", "name the device")
    if told and len(told) != count:
        raise raw.wrong(
            "meta", f"gives {len(told)} planes for the {count} {array}", "give one per column"
        )
    if pvs := _behind_pvs(raw, array, names, ring):
        return Named(array, tuple(name for name, _ in pvs), tuple(p for _, p in pvs), names)
    known = set(ring.table.name)
    taken = [_SUFFIX.fullmatch(name) for name in names]
    if not all(name in known for name in names) and all(taken):
        matches = [match for match in taken if match is not None]
        planes: tuple[ChannelPlane, ...] = tuple(
            _PLANE_OF_LETTER[match.group(2).lower()] for match in matches
        )
        bare = tuple(match.group(1) for match in matches)
        if max(Counter(zip(bare, planes, strict=True)).values()) == 1:
            return Named(array, bare, planes)
    if told:
        return Named(array, names, tuple(_PLANE_OF_LETTER[plane] for plane in told))
    return Named(array, names, _repeated(raw, array, names, ring))


def _behind_pvs(
    raw: Raw, array: str, names: tuple[str, ...], ring: Ring
) -> list[tuple[str, ChannelPlane]]:
    """Devices and planes of names that are PVs of the ring; none if they are not."""
    behind = ring.devices_of_pvs(_KINDS[array])
    strange = [row for row, name in enumerate(names) if name not in behind]
    if len(strange) > (1.0 - _MOSTLY) * len(names):
        return []
    if strange:
        row = strange[0]
        near = difflib.get_close_matches(names[row], behind, 1)
        hint = f" (do you mean {near[0]}?)" if near else ""
        raise raw.wrong(
            array,
            f"has {names[row]!r} in row {row}, which is no PV of a {_KINDS[array]} of the places "
            f"table{hint}; {len(strange)} of {len(names)} names are not known",
            "correct the name, leave its column out, or give the places table of your ring",
        )
    return [behind[name] for name in names]


def _repeated(raw: Raw, array: str, names: tuple[str, ...], ring: Ring) -> tuple[ChannelPlane, ...]:
    """Names that stand there twice: first x, then y."""
    counts = Counter(names)
    if max(counts.values()) > 2:
        name, many = counts.most_common(1)[0]
        rows = [row for row, its in enumerate(names) if its == name]
        raise raw.wrong(
            array,
            f"has {name!r} {many} times, in rows {', '.join(map(str, rows[:5]))}",
            "name every device once per plane",
        )
    if max(counts.values()) == 1:
        return ()
    alternating = len(names) % 2 == 0 and names[::2] == names[1::2]
    if alternating:
        return tuple("x" if row % 2 == 0 else "y" for row in range(len(names)))
    seen: set[str] = set()
    repeat = next(row for row, name in enumerate(names) if name in seen or seen.add(name))
    later = names[repeat:]
    single = len([name for name in names if counts[name] == 2])
    if single < len(names) * _MOSTLY or len(set(later)) != len(later):
        first = names.index(names[repeat])
        raise raw.wrong(
            array,
            f"has {names[repeat]!r} in row {first} and again in row {repeat}, and the names are "
            "not two blocks, x and then y",
            "name every device once per plane, x first and then y",
        )
    begin = _second_block(names, repeat, ring)
    return tuple("x" if row < begin else "y" for row in range(len(names)))


def _second_block(names: tuple[str, ...], repeat: int, ring: Ring) -> int:
    """Where y begins: at the first repeated name, or before, where the ring begins anew."""
    place = {name: index for index, name in enumerate(ring.table.name)}
    at = [place.get(name, -1) for name in names[: repeat + 1]]
    drops = [row for row in range(1, repeat + 1) if at[row] < at[row - 1]]
    return drops[0] if len(drops) == 1 else repeat


def known_ring(raw: Raw, named: Sequence[Named], ring: Ring) -> tuple[Ring | None, list[Finding]]:
    """Tell whether the names are those of a ring.

    Returns:
        The ring, or None and the finding that says what cannot be tested.

    Raises:
        RecordError: Most names are the ring's, but some are not.
    """
    strange: list[tuple[Named, int]] = []
    total = 0
    for each in named:
        known = set(ring.names(_KINDS[each.array]))
        strange += [(each, row) for row, name in enumerate(each.names) if name not in known]
        total += len(each.names)
    if not strange:
        return ring, []
    each, row = strange[0]
    if set(each.names) <= set(ring.names("COR" if _KINDS[each.array] == "BPM" else "BPM")):
        raise raw.wrong(
            each.array,
            f"has {each.names[row]!r} in row {row} and only devices of the other kind",
            "exchange bpm_names and corr_names",
        )
    if total - len(strange) >= _MOSTLY * total:
        near = difflib.get_close_matches(each.names[row], ring.names(_KINDS[each.array]), 1)
        hint = f" (do you mean {near[0]}?)" if near else ""
        raise raw.wrong(
            each.array,
            f"has {each.names[row]!r} in row {row}, which is no {_KINDS[each.array]} of the places "
            f"table{hint}; {len(strange)} of {total} names are not known",
            "correct the name, leave its column out, or give the places table of your ring",
        )
    return None, [
        Finding(
            "unknown-ring",
            "warning",
            (),
            None,
            f"{len(strange)} of {total} names, first {each.names[row]!r}, are in no known places "
            "table: effects of the optics are not tested, and what kicks between the devices is "
            "looked for at the correctors only, as if these kicked 50 µrad/A; give the places "
            "table of your ring",
        )
    ]


def complete_planes(
    raw: Raw,
    bpms: Named,
    correctors: Named,
    response: Matrix,
    ring: Ring | None,
    wanted: Planes | None,
    meta: Meta,
) -> tuple[Named, Named, list[Finding]]:
    """Decide the planes that the names do not tell.

    Args:
        raw: For messages.
        bpms: BPMs.
        correctors: Correctors.
        response: Model, shape (n, m) [m/A]; both planes couple little in it.
        ring: The ring that the names belong to, or None.
        wanted: What the caller says.
        meta: What the record says.

    Raises:
        RecordError: A device has two columns in one plane.
    """
    found: list[Finding] = []
    if not bpms.planes and not correctors.planes:
        # Names of a ring would stand there twice if there were two planes.
        told = meta.planes or ("" if wanted == "xy" and ring is not None else wanted) or ""
        if told == "xy":
            half = (len(bpms.names) + 1) // 2
            bpms = replace(
                bpms, planes=tuple("x" if i < half else "y" for i in range(len(bpms.names)))
            )
        else:
            plane, finding = _single_plane(bpms, correctors, response, ring, told)
            found += finding
            bpms = replace(bpms, planes=(plane,) * len(bpms.names))
            correctors = replace(correctors, planes=(plane,) * len(correctors.names))
    if not correctors.planes:
        correctors = replace(correctors, planes=_stronger(response, bpms.planes))
    if not bpms.planes:
        bpms = replace(bpms, planes=_stronger(response.T, correctors.planes))
    for each in (bpms, correctors):
        columns = list(zip(each.names, each.planes, strict=True))
        twice = [pair for pair, many in Counter(columns).items() if many > 1]
        if twice:
            rows = [row for row, pair in enumerate(columns) if pair == twice[0]]
            raise raw.wrong(
                each.array,
                f"has {twice[0][0]!r} ({twice[0][1]}) in rows {', '.join(map(str, rows[:5]))}",
                "name every device once per plane",
            )
    return bpms, correctors, found


def _stronger(response: Matrix, planes: tuple[ChannelPlane, ...]) -> tuple[ChannelPlane, ...]:
    """Give every column the plane in whose rows it is stronger."""
    in_x = np.array([plane == "x" for plane in planes])
    power = response**2
    return tuple("x" if power[in_x, j].sum() >= power[~in_x, j].sum() else "y" for j in
                 range(response.shape[1]))  # fmt: skip


def _single_plane(
    bpms: Named, correctors: Named, response: Matrix, ring: Ring | None, told: str
) -> tuple[ChannelPlane, list[Finding]]:
    said: ChannelPlane | None = "x" if told == "x" else "y" if told == "y" else None
    if ring is None:
        if said:
            return said, []
        text = "nothing tells the plane; it is called x (meta: planes, or --planes, would tell)"
        return "x", [Finding("plane", "note", (), None, text)]
    likeness = {p: correlation(response, ring_block(ring, bpms, correctors, p)) for p in ("x", "y")}
    best: ChannelPlane = "x" if abs(likeness["x"]) >= abs(likeness["y"]) else "y"
    figures = f"correlation with the ring's optics: x {likeness['x']:.3f}, y {likeness['y']:.3f}"
    if said:
        return said, []
    text = f"model_R tells that the plane is {best} ({figures})"
    return best, [Finding("plane", "note", (), None, text)]


def ring_block(ring: Ring, bpms: Named, correctors: Named, plane: Plane) -> Matrix:
    """Response of the ring's optics between named devices, taken in one plane [m/A]."""
    place = {name: index for index, name in enumerate(ring.table.name)}
    rows = np.array([place[name] for name in bpms.names], dtype=np.intp)
    columns = np.array([place[name] for name in correctors.names], dtype=np.intp)
    table_row = 0 if plane == "x" else 1
    # A corrector that is not in the plane kicks nothing there.
    per_ampere = np.nan_to_num(ring.table.calibration[table_row, columns])
    return green(ring, rows, columns, plane) * per_ampere


def correlation(first: Matrix, second: Matrix) -> float:
    """Give the cosine between two matrices; 0 when one of them is zero."""
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(np.sum(first * second)) / size if size > 0.0 else 0.0


def restriction_note(planes: str, kept: int, total: int) -> Finding:
    """Say that only some columns are looked at."""
    text = f"only the {planes} plane is looked at: {kept} of {total} BPM columns"
    return Finding("plane", "note", (), None, text)

"""Read a measured response of any of the formats that laboratories keep them in.

What `orbitfb measure-response` and `orbitfb import response` write; a `.mat` of the Matlab Middle
Layer (`Rmat`, with UnitsString) or of LOCO (`LocoMeasData`, kicks in `CMData`); CSV, HDF5 and other
`.mat` with names; `.npy`, `.npz` and JSON. Devices that the table lacks are left out, and said.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.exchange.units import PER_KICK, RESPONSE, factor
from orbitfb.loco.input.dispersion import of_blocks, of_file
from orbitfb.loco.input.labels import labels, masked
from orbitfb.loco.input.matrix import Raw
from orbitfb.loco.input.raw import raw_blocks
from orbitfb.loco.measured import PLANES, Measured, Pair, from_setpoints
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices, Kind, Plane, Planes, Ring, plane_row, split

_MOST_TOLD = 6
_MOST_UNKNOWN = 0.5
"""Share of names that the table may lack; beyond, the table is of another ring [1]."""


@dataclass(frozen=True, slots=True)
class Request:
    """What the caller says of a file.

    Args:
        file: The file.
        unit: Of the matrix; None: as the file says.
        planes: That it is of; None: as its names or its shape say.
        matrix: Path of the matrix within the file; None: the usual one of its format.
        bpm_names: Path of the names of the BPMs, or @FILE.
        corrector_names: Names of the correctors, in the same way.
        transpose: Its rows are correctors.
        noise: Standard deviation of a measured change of an orbit [m]; None: as the file says.
        kick: That made the change [rad].
        dispersion: Table of the measured horizontal dispersion; None: that of the file, if any.
        masked: Devices that are left out, NAME or NAME:x.
    """

    file: Path
    unit: str | None = None
    planes: Planes | None = None
    matrix: str | None = None
    bpm_names: str | None = None
    corrector_names: str | None = None
    transpose: bool = False
    noise: float | None = None
    kick: float = 100e-6
    dispersion: Path | None = None
    masked: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A measured response, and what is to be said of how it was read."""

    measured: Measured
    notes: tuple[str, ...] = field(default=())


def load(request: Request, ring: Ring) -> Loaded:
    """Read a measured response.

    Args:
        request: The file, and what is said of it.
        ring: The ring.

    Raises:
        ExchangeError: It cannot be read, or does not say what its rows, columns or unit are.
    """
    notes: list[str] = []
    raws = [
        _turned(raw) if request.transpose else raw
        for raw in raw_blocks(
            request.file, request.matrix, request.bpm_names, request.corrector_names
        )
        if raw.pair is None or request.planes is None or set(raw.pair) <= set(request.planes)
    ]
    blocks = [_placed(raw, request, ring, notes) for raw in raws]
    bpms, correctors = _devices(blocks, 0), _devices(blocks, 1)
    response: dict[Pair, Matrix] = {}
    sigma: dict[Pair, Matrix] = {}
    for read, rows in bpms.items():
        for driven, columns in correctors.items():
            values, errors = _block(blocks, (read, driven), rows, columns)
            if np.isfinite(values).any() and np.nanmax(np.abs(values)) > 0.0:
                response[read, driven], sigma[read, driven] = values, errors
    if not any((plane, plane) in response for plane in PLANES):
        raise ExchangeError(
            f"{request.file}: no plane has both BPMs and correctors in it; say with --planes which "
            "plane it is of"
        )
    measured = from_setpoints(ring, bpms, correctors, response, sigma)
    horizontal = bpms.get("x", np.empty(0, dtype=np.intp))
    known = labels(ring, "BPM")
    eta = (
        of_blocks(
            [(raw, its.rows) for raw, its in zip(raws, blocks, strict=True)], horizontal, ring
        )
        if request.dispersion is None
        else of_file(request.dispersion, horizontal, known)
    )
    if eta is not None and "x" in measured.planes:
        notes.append(f"dispersion of {int(np.isfinite(eta).sum())} BPMs is fitted with it")
        measured = replace(measured, dispersion=eta)
    if request.masked:
        measured = masked(measured, request.masked, ring)
        notes.append(f"left out as asked: {', '.join(request.masked)}")
    if request.noise is not None:
        error = request.noise / request.kick
        measured = replace(
            measured,
            sigma={pair: np.full_like(its, error) for pair, its in measured.response.items()},
        )
    notes += _holes(measured)
    return Loaded(measured, tuple(notes))


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    values: Matrix
    sigma: Matrix
    rows: tuple[tuple[Plane, int] | None, ...]
    columns: tuple[tuple[Plane, int] | None, ...]


def _turned(raw: Raw) -> Raw:
    sigma = None if raw.sigma is None else raw.sigma.T
    return replace(raw, values=raw.values.T, sigma=sigma, rows=raw.columns, columns=raw.rows)


def _placed(raw: Raw, request: Request, ring: Ring, notes: list[str]) -> _Placed:
    planes = raw.planes or request.planes
    unit, size = factor(request.unit, raw.unit, RESPONSE, f"{request.file}: {raw.where}", "--unit")
    rows = _where(raw, 0, planes, ring, "BPM", request, notes)
    columns = _where(raw, 1, planes, ring, "COR", request, notes)
    values = raw.values * size
    sigma = np.full_like(values, np.nan) if raw.sigma is None else raw.sigma * size
    if sigma.shape != values.shape or np.any(sigma < 0.0):
        raise ExchangeError(
            f"{request.file}: sigma has shape {sigma.shape} and {int(np.sum(sigma < 0.0))} "
            f"negative values; give a standard deviation for each of the {values.shape} of "
            f"{raw.where}, NaN where it is not known"
        )
    if unit in PER_KICK:
        per_ampere = np.array(
            [
                1.0 if its is None else ring.table.calibration[plane_row(its[0]), its[1]]
                for its in columns
            ]
        )
        values, sigma = values * per_ampere, sigma * np.abs(per_ampere)
    return _Placed(values, sigma, rows, columns)


def _where(
    raw: Raw,
    axis: int,
    planes: str | None,
    ring: Ring,
    kind: Kind,
    request: Request,
    notes: list[str],
) -> tuple[tuple[Plane, int] | None, ...]:
    """Find plane and place of every row (axis 0) or column (axis 1); None: not in the table."""
    names = (raw.rows, raw.columns)[axis]
    what = ("BPMs", "correctors")[axis]
    count = raw.values.shape[axis]
    plane = (raw.pair[axis],) if raw.pair else tuple(split(_planes_of(planes)) if planes else ())
    if not names:
        its_own = {p: ring.places(kind, p).tolist() for p in PLANES}
        chosen = _plain(plane or PLANES)
        if count == sum(len(its_own[p]) for p in chosen):
            notes.append(
                f"{what}: no names; taken in the order of the places table, plane "
                f"{' then '.join(chosen)}"
            )
            return tuple((p, i) for p in chosen for i in its_own[p])
        there = " and ".join(f"{len(its_own[p])} {what} in {p}" for p in PLANES)
        raise ExchangeError(
            f"{request.file}: {raw.where} has {count} {('rows', 'columns')[axis]} without names; "
            f"the table has {there}; give --planes, --transpose, or names "
            f"({('--bpm-names', '--corrector-names')[axis]})"
        )
    if len(names) != count:
        raise ExchangeError(
            f"{request.file}: {len(names)} names for {count} {what} of {raw.where}; name each "
            "once (--transpose, if its rows are correctors)"
        )
    known = labels(ring, kind)
    found: list[tuple[Plane, int] | None] = []
    unknown: list[str] = []
    elsewhere: list[str] = []
    for name in names:
        its = known.get(name)
        if its is None:
            unknown.append(name)
            found.append(None)
        elif its[0] is not None and len(plane) == 1 and its[0] != plane[0]:
            elsewhere.append(name)
            found.append(None)
        elif its[0] is not None:
            found.append((its[0], its[1]))
        elif len(plane) == 1:
            found.append((_plain(plane)[0], its[1]))
        else:
            raise ExchangeError(
                f"{request.file}: {what} {name!r} may be of either plane; name them NAME:x and "
                "NAME:y, or give --planes x or y"
            )
    if len(unknown) > _MOST_UNKNOWN * count:
        others = labels(ring, "COR" if kind == "BPM" else "BPM")
        if sum(name in others for name in unknown) > _MOST_UNKNOWN * count:
            raise ExchangeError(
                f"{request.file}: the {('rows', 'columns')[axis]} of {raw.where} are "
                f"{('correctors', 'BPMs')[axis]}, such as {unknown[0]!r}; "
                f"{'leave --transpose out' if request.transpose else 'give --transpose'}"
            )
        hint = did_you_mean(unknown[0], known, most=1)
        raise ExchangeError(
            f"{request.file}: {len(unknown)} of {count} {what} are not in the places table, such "
            f"as {unknown[0]!r}{hint}; name its table with --places and --ring"
        )
    for left_out, why in ((unknown, "the table lacks"), (elsewhere, "are of the other plane")):
        if left_out:
            told = ", ".join(left_out[:_MOST_TOLD]) + " …" * (len(left_out) > _MOST_TOLD)
            notes.append(f"{len(left_out)} {what} that {why} are left out: {told}")
    seen = [its for its in found if its is not None]
    if len(set(seen)) != len(seen):
        twice = next(its for its in seen if seen.count(its) > 1)
        raise ExchangeError(
            f"{request.file}: {ring.table.name[twice[1]]}:{twice[0]} is named twice among the "
            f"{what}; leave one out"
        )
    return tuple(found)


def _planes_of(planes: str) -> Planes:
    return "x" if planes == "x" else "y" if planes == "y" else "xy"


def _plain(planes: Sequence[str]) -> tuple[Plane, ...]:
    return tuple(plane for plane in PLANES if plane in planes)


def _devices(blocks: Sequence[_Placed], axis: int) -> dict[Plane, Indices]:
    found: dict[Plane, Indices] = {}
    for plane in PLANES:
        places = {
            its[1]
            for block in blocks
            for its in (block.rows, block.columns)[axis]
            if its is not None and its[0] == plane
        }
        if places:
            found[plane] = np.array(sorted(places), dtype=np.intp)
    return found


def _block(
    blocks: Sequence[_Placed], pair: Pair, rows: Indices, columns: Indices
) -> tuple[Matrix, Matrix]:
    values = np.full((len(rows), len(columns)), np.nan)
    sigma = np.full_like(values, np.nan)
    row_of = {int(place): number for number, place in enumerate(rows)}
    column_of = {int(place): number for number, place in enumerate(columns)}
    for block in blocks:
        here = [
            (k, row_of[its[1]]) for k, its in enumerate(block.rows) if its and its[0] == pair[0]
        ]
        there = [
            (k, column_of[its[1]])
            for k, its in enumerate(block.columns)
            if its and its[0] == pair[1]
        ]
        if here and there:
            source = np.ix_([k for k, _ in here], [k for k, _ in there])
            target = np.ix_([k for _, k in here], [k for _, k in there])
            values[target], sigma[target] = block.values[source], block.sigma[source]
    return np.where(np.isfinite(values), values, np.nan), sigma


def _holes(measured: Measured) -> list[str]:
    notes: list[str] = []
    for plane in measured.planes:
        there = np.isfinite(measured.response[plane, plane])
        rows, columns = int((~there.any(axis=1)).sum()), int((~there.any(axis=0)).sum())
        if not there.all():
            notes.append(
                f"plane {plane}: {int((~there).sum())} elements were not measured ({rows} whole "
                f"rows, {columns} whole columns); they do not count"
            )
    return notes

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
from orbitfb.exchange.units import PER_KICK, RESPONSE, factor
from orbitfb.loco.input.axes import Axis, Channel, find_places
from orbitfb.loco.input.dispersion import of_blocks, of_file
from orbitfb.loco.input.labels import labels, masked
from orbitfb.loco.input.matrix import Raw
from orbitfb.loco.input.raw import raw_blocks
from orbitfb.loco.measured import PLANES, Measured, Pair, from_setpoints
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices, Plane, Planes, Ring, plane_row


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
    rows: tuple[Channel | None, ...]
    columns: tuple[Channel | None, ...]


def _turned(raw: Raw) -> Raw:
    sigma = None if raw.sigma is None else raw.sigma.T
    return replace(raw, values=raw.values.T, sigma=sigma, rows=raw.columns, columns=raw.rows)


def _placed(raw: Raw, request: Request, ring: Ring, notes: list[str]) -> _Placed:
    planes = raw.planes or request.planes
    unit, size = factor(request.unit, raw.unit, RESPONSE, f"{request.file}: {raw.where}", "--unit")
    turned = request.transpose
    rows = find_places(Axis(request.file, raw, 0, planes, turned), ring, notes)
    columns = find_places(Axis(request.file, raw, 1, planes, turned), ring, notes)
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

"""Put devices, model and rows together to a record."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.finding import Finding
from orbitfb.records.layout import ChannelPlane, Layout
from orbitfb.records.reading.archive import read_transitions
from orbitfb.records.reading.arrays import dropped_columns, transitions_from
from orbitfb.records.reading.devices import (
    Named,
    complete_planes,
    known_ring,
    plain_names,
    restriction_note,
    ring_block,
)
from orbitfb.records.reading.metadata import Meta, read_meta, unread_keys
from orbitfb.records.reading.raw import Raw
from orbitfb.records.reading.stretches import Transition, join
from orbitfb.records.record import Record

MOST_INVALID = 0.05
"""Share of its readings that a BPM may lack; with more it is left out [1]."""

_PERIODS_AGREE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A record, and what was noticed on the way.

    Args:
        record: The record.
        findings: Gaps, devices left out, arrays made up, planes decided.
    """

    record: Record
    findings: tuple[Finding, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Model:
    """Devices, model and ring of a record."""

    bpms: Named
    correctors: Named
    response: Matrix
    ring: Ring | None


def from_arrays(
    raw: Raw, planes: Planes | None, ring: Ring, response: Matrix | None, period: float | None
) -> Loaded:
    """Make the record of the exchange format's arrays; arguments as for `load`.

    Raises:
        RecordError: An array is wrong.
    """
    meta = read_meta(raw)
    rows, found = transitions_from(raw, meta)
    found += unread_keys(raw)
    model = _model(raw, rows, meta, planes, ring, response, found)
    seconds = _period(rows.time, period, meta.period, found)
    return _assemble(raw.path, rows, model, planes, seconds, found)


def from_archive(
    path: Path,
    planes: Planes | None,
    ring: Ring,
    response: Matrix | None,
    period: float | None,
    largest: int,
) -> Loaded:
    """Make the record of an archive; arguments as for `load`.

    Raises:
        RecordError: It cannot be read, or its devices are of no known ring.
    """
    channels, rows, found = read_transitions(path, largest)
    each: tuple[ChannelPlane, ...] = ("x", "y") if channels.planes == "xy" else (
        ("y",) if channels.planes == "y" else ("x",)
    )  # fmt: skip

    def named(array: str, names: tuple[str, ...], parts: Mapping[str, slice]) -> Named:
        return Named(array, names, tuple(plane for plane in each for _ in names[parts[plane]]))

    raw = Raw(path, {}, {})
    bpms = named("bpm_names", channels.bpms, channels.bpm_parts)
    correctors = named("corr_names", channels.correctors, channels.corrector_parts)
    its_ring, unknown = known_ring(raw, (bpms, correctors), ring)
    found += unknown
    if response is None:
        if its_ring is None:
            raise RecordError(
                f"{path}: its devices are in no known places table (first BPM {channels.bpms[0]}), "
                "and an archive holds no model; give the places table of its ring"
            )
        response = ring_response(its_ring, bpms, correctors)
    response = _checked(path, response, len(bpms.names), len(correctors.names))
    model = _Model(bpms, correctors, response, its_ring)
    return _assemble(path, rows, model, planes, _period(rows.time, period, None, found), found)


def ring_response(ring: Ring, bpms: Named, correctors: Named) -> Matrix:
    """Response of the ring's optics between named devices, shape (n, m) [m/A]."""
    response = np.zeros((len(bpms.names), len(correctors.names)))
    for plane in ("x", "y"):
        rows = np.array([p == plane for p in bpms.planes])
        columns = np.array([p == plane for p in correctors.planes])
        if rows.any() and columns.any():
            response[np.ix_(rows, columns)] = ring_block(
                ring, bpms.only(plane), correctors.only(plane), plane
            )
    return response


def _model(
    raw: Raw,
    rows: Transition,
    meta: Meta,
    planes: Planes | None,
    ring: Ring,
    response: Matrix | None,
    found: list[Finding],
) -> _Model:
    n, m = rows.orbit.shape[1], rows.setpoints.shape[1]
    bpms = plain_names(raw, "bpm_names", n, meta.bpm_planes, ring)
    correctors = plain_names(raw, "corr_names", m, meta.corr_planes, ring)
    its_ring, unknown = known_ring(raw, (bpms, correctors), ring)
    found += unknown
    if response is None and "model_R" in raw.numbers:
        response = raw.numbers["model_R"] * meta.factor(raw, "model_R")
    if response is not None:
        response = _checked(raw.path, response, n, m)
        bpms, correctors, decided = complete_planes(
            raw, bpms, correctors, response, its_ring, planes, meta
        )
        found += decided
        return _Model(bpms, correctors, response, its_ring)
    if its_ring is None:
        raise raw.wrong(
            "model_R", "is missing, and the names are of no known ring", "add the model response"
        )
    nothing = np.zeros((n, m))
    bpms, correctors, decided = complete_planes(
        raw, bpms, correctors, nothing, None, planes, meta
    )  # fmt: skip
    text = "array 'model_R' is missing; the optics of the places table are the model"
    found += [*decided, Finding("missing-array", "note", (), None, text)]
    return _Model(bpms, correctors, ring_response(its_ring, bpms, correctors), its_ring)


def _checked(path: Path, response: Matrix, n: int, m: int) -> Matrix:
    if response.shape != (n, m):
        raise RecordError(
            f"{path}: the model has shape {response.shape}, the record {n} BPMs and {m} "
            "correctors; give one row per BPM and one column per corrector"
        )
    if not np.isfinite(response).all() or not response.any():
        raise RecordError(f"{path}: array 'model_R' is not finite, or zero; give the model")
    return response


def _period(time: Vector, wanted: float | None, told: float | None, found: list[Finding]) -> float:
    """Decide from the caller's word, the record's, and its clock, in this order."""
    measured = float(np.median(np.diff(time)))
    if wanted is not None:
        return wanted
    if told is None:
        return measured
    if abs(told / measured - 1.0) > _PERIODS_AGREE:
        text = (
            f"meta says that orbits are dt_s = {told:g} s apart, array 't' says {measured:.4g} s; "
            "'t' is believed"
        )
        found.append(Finding("period", "warning", (), None, text))
        return measured
    return told


def _assemble(
    path: Path,
    rows: Transition,
    model: _Model,
    planes: Planes | None,
    period: float,
    found: list[Finding],
) -> Loaded:
    bpms, correctors = model.bpms, model.correctors
    both = "".join(plane for plane in ("x", "y") if plane in bpms.planes)
    if planes is not None and not set(planes) <= set(both):
        raise RecordError(
            f"{path}: the record has BPMs in {both}, not in {planes}; ask for --planes {both}"
        )
    wanted = planes or both
    in_bpms = np.array([plane in wanted for plane in bpms.planes])
    in_correctors = np.array([plane in wanted for plane in correctors.planes])
    if not in_correctors.any():
        raise RecordError(f"{path}: no corrector acts in {wanted}; check the names' planes")
    if not in_bpms.all():
        found.append(restriction_note(wanted, int(in_bpms.sum()), len(in_bpms)))
    shares = 1.0 - np.isfinite(rows.orbit).mean(axis=0)
    keep = shares <= MOST_INVALID
    labels = [f"{name} ({plane})" for name, plane in zip(bpms.names, bpms.planes, strict=True)]
    if not (keep | ~in_bpms).all():
        found.append(dropped_columns(keep | ~in_bpms, labels, shares))
    in_bpms &= keep
    if not in_bpms.any():
        raise RecordError(
            f"{path}: every BPM lacks more than {100 * MOST_INVALID:.0f} % of its readings; give a "
            "record of working BPMs"
        )
    kept_bpms = np.flatnonzero(in_bpms)
    kept_correctors = np.flatnonzero(in_correctors)
    layout = Layout(
        bpms=bpms.devices(kept_bpms),
        correctors=correctors.devices(kept_correctors),
        response=np.ascontiguousarray(model.response[np.ix_(kept_bpms, kept_correctors)]),
        period=period,
        ring=model.ring,
    )
    record, noticed = join(rows.columns(kept_bpms, kept_correctors), layout, str(path))
    return Loaded(record, (*found, *noticed))

"""Join transitions to the unbroken stretches of a record."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.digest import digest_of
from orbitfb.records.finding import Finding, counted
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

FEWEST_ROWS = 40
"""Fewest transitions by which noise can be told from motion."""

_ROUNDING = 0.05
"""Most that setpoints may be beside the sums of the actions, of the actions' rms [1]."""

_GAP = 0.6
_ABOUT = 4


@dataclass(frozen=True, slots=True, eq=False)
class Transition:
    """T transitions in SI, before they are joined.

    Args:
        time: Of the reading, shape (T,) [s].
        orbit: Shape (T, n) [m]; NaN where not valid.
        next_orbit: Shape (T, n) [m].
        setpoints: In force when `orbit` was read, shape (T, m) [A].
        requested: Change asked for, shape (T, m) [A].
        follows: Whether row k+1 begins with the orbit that row k ends with, shape (T - 1,).
        readback, dither: Shape (T, m) [A], or None.
        reference: Shape (T, n) [m], or None.
        auxiliary: Slow channels, each (T,).
    """

    time: Vector
    orbit: Matrix
    next_orbit: Matrix
    setpoints: Matrix
    requested: Matrix
    follows: Mask
    readback: Matrix | None
    dither: Matrix | None
    reference: Matrix | None
    auxiliary: Mapping[str, Vector]

    def __len__(self) -> int:
        return len(self.time)

    def columns(self, bpms: Any, correctors: Any) -> "Transition":
        """Keep some BPMs and correctors."""
        kept: dict[str, Any] = {}
        for name in ("orbit", "next_orbit", "reference"):
            columns = getattr(self, name)
            kept[name] = None if columns is None else columns[:, bpms]
        for name in ("setpoints", "requested", "readback", "dither"):
            columns = getattr(self, name)
            kept[name] = None if columns is None else columns[:, correctors]
        return replace(self, **kept)

    def take(self, rows: Mask) -> "Transition":
        """Keep some rows; what stood on both sides of a row left out does not follow."""
        kept: dict[str, Any] = {}
        for field in fields(self):
            columns = getattr(self, field.name)
            if field.name == "follows":
                index = np.flatnonzero(rows)
                kept["follows"] = columns[index[:-1]] & (np.diff(index) == 1)
            elif field.name == "auxiliary":
                kept["auxiliary"] = {name: values[rows] for name, values in columns.items()}
            else:
                kept[field.name] = None if columns is None else columns[rows]
        return replace(self, **kept)


def time_jumps(time: Vector, period: float) -> Mask:
    """Tell where the clock jumps by a tick or more, shape (T - 1,).

    A jump shifts all later stamps; a stamp that trembles does not, so the shift is read from the
    medians of some rows on either side.

    Args:
        time: Increasing, shape (T,) [s].
        period: From one tick to the next [s].
    """
    phase = time - period * np.arange(len(time))
    steps = np.diff(phase)
    jumps = np.abs(steps) > _GAP * period
    for row in np.flatnonzero(jumps):
        before = np.median(phase[max(0, row - _ABOUT) : row + 1])
        after = np.median(phase[row + 1 : row + 2 + _ABOUT])
        jumps[row] = abs(after - before) > _GAP * period
    return jumps


def one_missing(time: Vector, period: float) -> Mask:
    """Tell where a single row is missing, shape (T - 1,).

    The rows beside it tell all but what it asked for: the orbit after the one before, and what the
    correctors did until then.
    """
    found: Mask = np.abs(np.diff(time) - 2.0 * period) < (1.0 - _GAP) * period
    return found


def join(rows: Transition, layout: Layout, source: str) -> tuple[Record, list[Finding]]:
    """Make the record: every stretch gets its last next orbit as one more row.

    Readings that are not valid are filled in: the last valid one, moved by what the model says
    of the setpoints since. A single row that is missing does not end a stretch: this row stands for
    it.

    Args:
        rows: The transitions.
        layout: Devices and model of their columns.
        source: Where they came from, for people.
    """
    jumps = time_jumps(rows.time, layout.period)
    # What follows over a jump of the clock is the orbit of much later.
    late = np.append(rows.follows & jumps, False)
    whole, rows = rows, replace(rows, follows=rows.follows & ~jumps)
    after = _after(rows)
    known = np.isfinite(after).all(axis=1) & ~late
    if known.sum() < FEWEST_ROWS:
        raise RecordError(
            f"{source}: of {int(known.sum())} of {len(rows)} rows it is known what the correctors "
            f"did until the next orbit, {FEWEST_ROWS} are needed; give 'action', and rows in the "
            "order in which they were read"
        )
    rows, after = rows.take(known), after[known]
    ends = np.append(~rows.follows, True)
    begins = np.insert(~rows.follows, 0, True)
    # Place of every transition's row in the record, and of the extra row of every stretch.
    position = np.arange(len(rows)) + np.concatenate([[0], np.cumsum(ends[:-1])])
    extra = position[ends] + 1
    total = len(rows) + int(ends.sum())

    def spread(columns: Vector, last: Vector) -> Vector:
        out = np.empty((total, *columns.shape[1:]))
        out[position], out[extra] = columns, last
        return out

    readings = spread(rows.orbit, rows.next_orbit[ends])
    setpoints = spread(rows.setpoints, after[ends])
    starts = np.zeros(total, dtype=np.bool_)
    starts[position[begins]] = True
    bridged = ~rows.follows & one_missing(rows.time, layout.period)
    starts[position[1:][bridged]] = False
    filled = ~np.isfinite(readings)
    time = spread(rows.time, rows.time[ends] + layout.period) - rows.time[0]
    requested = spread(rows.requested, np.full_like(after[ends], np.nan))
    readback = None
    if rows.readback is not None:
        readback = spread(rows.readback, (rows.readback + after - rows.setpoints)[ends])
    record = Record(
        layout=layout,
        time=time,
        starts=starts,
        readings=_filled(readings, setpoints, layout.response),
        setpoints=setpoints,
        requested=requested,
        readback=readback,
        dither=None if rows.dither is None else spread(rows.dither, np.zeros_like(after[ends])),
        reference=None if rows.reference is None else spread(rows.reference, rows.reference[ends]),
        filled=filled,
        auxiliary={name: spread(each, each[ends]) for name, each in rows.auxiliary.items()},
        source=source,
        digest=digest_of(time, readings, setpoints, np.nan_to_num(requested), layout.response),
        began=float(rows.time[0]),
    )
    before = position[np.maximum(np.cumsum(known) - 1, 0)]
    return record, [*_gap_findings(whole, before, jumps, layout.period), *_filled_findings(record)]


def _after(rows: Transition) -> Matrix:
    """Setpoints in force at every next orbit, shape (T, m) [A]; NaN where nobody knows.

    The next row tells them. At the end of a stretch only the change asked for does, and that is
    believed if, elsewhere, the setpoints are its sums.
    """
    told, told_by_next = rows.setpoints + rows.requested, rows.setpoints[1:][rows.follows]
    error = np.abs(told_by_next - told[:-1][rows.follows]).max(initial=0.0)
    size = np.sqrt(np.mean(rows.requested[:-1][rows.follows] ** 2)) if rows.follows.any() else 0.0
    after = told if error <= _ROUNDING * size else np.full_like(told, np.nan)
    after[:-1][rows.follows] = told_by_next
    return after


def _filled(readings: Matrix, setpoints: Matrix, response: Matrix) -> Matrix:
    """Carry the part of the orbit that the correctors do not make over invalid readings."""
    full = readings.copy()
    rows = np.arange(len(readings))
    for column in np.flatnonzero(~np.isfinite(readings).all(axis=0)):
        valid = np.isfinite(readings[:, column])
        made = setpoints @ response[column]
        rest = readings[:, column] - made
        last = np.maximum.accumulate(np.where(valid, rows, -1))
        last[last < 0] = int(np.argmax(valid))
        full[:, column] = np.where(valid, readings[:, column], rest[last] + made)
    return full


def _gap_findings(rows: Transition, position: Indices, jumps: Mask, period: float) -> list[Finding]:
    found: list[Finding] = []
    single = jumps & ~rows.follows & one_missing(rows.time, period)
    if single.any():
        at = np.flatnonzero(single)
        span = (int(position[at[0]]), int(position[at[-1]]) + 1)
        text = (
            f"a row is missing at {counted(len(at), 'place')}, first after row {int(at[0])} of the "
            "file; the rows beside it tell what it had"
        )
        found.append(Finding("missing-row", "note", (), span, text))
    jumps = jumps & ~single
    if jumps.any():
        at = np.flatnonzero(jumps)
        first = int(position[at[0]])
        longest = float(np.max(np.diff(rows.time)[at]))
        found.append(
            Finding(
                "time-gap",
                "warning",
                (),
                (first, int(position[at[-1]]) + 1),
                f"the time jumps at {counted(len(at), 'row')}, first after row {int(at[0])} of "
                f"the file, at most by {longest:.3g} s; the record is split there",
            )
        )
    lost = ~rows.follows & ~jumps & ~single
    if lost.any():
        at = np.flatnonzero(lost)
        first = int(position[at[0]])
        found.append(
            Finding(
                "sequence-gap",
                "warning",
                (),
                (first, int(position[at[-1]]) + 1),
                f"at {counted(len(at), 'row')}, first row {int(at[0])} of the file, next_orbit is "
                "not the orbit of the row after it although the time is continuous; rows are "
                "missing, and the record is split there",
            )
        )
    return found


def _filled_findings(record: Record) -> list[Finding]:
    columns = np.flatnonzero(record.filled.any(axis=0))
    if not len(columns):
        return []
    at = np.flatnonzero(record.filled.any(axis=1))
    return [
        Finding(
            "invalid-readings",
            "note",
            tuple(record.layout.bpms.label(int(column)) for column in columns),
            (int(at[0]), int(at[-1])),
            f"{int(record.filled.sum())} readings of {len(columns)} BPMs are not valid; they are "
            "filled in from the last valid one and the model",
        )
    ]

"""Read orbit histories: arrays of one file, a table of named columns, or an archiver's answer."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels, Vector
from orbitfb.exchange.formats.archiver import Samples, read_archiver
from orbitfb.exchange.formats.csv_file import CsvSource
from orbitfb.exchange.formats.datasets import Found, Source, column_of, matrix_of
from orbitfb.exchange.formats.source import names_from, open_source
from orbitfb.exchange.naming import bpm_labels, corrector_labels, places_of
from orbitfb.exchange.orbits.align import at_ticks, find_ticks, in_force
from orbitfb.exchange.orbits.history import History, empty_history
from orbitfb.exchange.times import seconds_of
from orbitfb.exchange.units import CURRENT, ORBIT, TIME, factor

_EPOCH_OF_DATENUM = 719_529.0
"""1970-01-01 in days of MATLAB's datenum."""

_NANO = 1e9
_TIME_NAMES = ("time", "timestamp", "t", "date", "datetime")
"""What programs call the column of the time, in lower case."""


@dataclass(frozen=True, slots=True)
class HistoryRequest:
    """What the caller says of the files of a history.

    Args:
        files: The files; several only if they are an archiver's.
        time, orbit, setpoints: Paths within the file; `time` and `orbit` of a CSV table are
            columns, found by their names.
        bpm_names, corrector_names: Paths of names, or @FILE.
        order: `names`, or `table`.
        time_unit, orbit_unit, setpoint_unit: None: as the file says.
        time_zone: Of times that are text and do not say theirs; None: none is known.
        tolerance: How far apart the stamps of one tick may lie [s].
        hold: Longest time for which an archived setpoint stands [s]; None: any.
    """

    files: tuple[Path, ...]
    time: str | None = None
    orbit: str | None = None
    setpoints: str | None = None
    bpm_names: str | None = None
    corrector_names: str | None = None
    order: str = "names"
    time_unit: str | None = None
    orbit_unit: str | None = None
    setpoint_unit: str | None = None
    time_zone: str | None = None
    tolerance: float = 0.01
    hold: float | None = None


def read_history(
    request: HistoryRequest, channels: Channels, slow: Mapping[str, tuple[str, float]]
) -> tuple[History, dict[str, Any]]:
    """Read a history, whatever it is in.

    Args:
        request: The files, and what is said of them.
        channels: Of the ring.
        slow: By name, PV of a slow channel and what its value is multiplied with to be SI.

    Returns:
        The history, and what was noticed on the way.

    Raises:
        ExchangeError: A file is not readable, or something is not said.
    """
    if all(path.suffix.lower() == ".json" for path in request.files):
        return _from_archiver(request, channels, slow)
    if len(request.files) != 1:
        raise ExchangeError("give one file, or several .json of an archiver")
    source = open_source(request.files[0])
    if isinstance(source, CsvSource) and source.columns:
        return _from_table(request, source, channels), {}
    return _from_arrays(request, source, channels), {}


def _time(found: Found, request: HistoryRequest, path: Path) -> Vector:
    """Read times, numbers or texts, shape (T,) [s]."""
    what = f"{path}: {found.where}"
    if found.texts:
        if request.time_unit:
            raise ExchangeError(f"{what} holds times as text; leave --time-unit out")
        return seconds_of(found.texts, request.time_zone, what)
    numbers = column_of(found, path)
    unit, size = factor(request.time_unit, found.units, TIME, what, "--time-unit")
    return (numbers - _EPOCH_OF_DATENUM) * size if unit == "datenum" else numbers * size


def _time_column(request: HistoryRequest, source: CsvSource) -> int:
    """Find the column of the time: the one that is named, is called time, or holds times."""
    names = [_split(name)[0] for name in source.columns]
    if request.time:
        found = [i for i, whole in enumerate(source.columns) if request.time in (whole, names[i])]
    else:
        found = [i for i, name in enumerate(names) if name.lower() in _TIME_NAMES]
        found = found or sorted(source.times)
    if len(found) != 1:
        raise ExchangeError(
            f"{source.path}: no column {request.time or 'time'!r} for the time (there are: "
            f"{', '.join(source.columns[:10])} …); say which with --time"
        )
    return found[0]


def _from_table(request: HistoryRequest, source: CsvSource, channels: Channels) -> History:
    """Take the columns that are named as devices of the ring; the others must be few and known."""
    if len(source.rows):
        raise ExchangeError(
            f"{source.path}: its rows begin with names ({source.rows[0]!r}), which are no times; "
            "begin them with numbers, or times such as 2024-10-27T02:59:54.100+01:00"
        )
    place = _time_column(request, source)
    name, unit = _split(source.columns[place])
    stamps = Found(name, source.values[:, place], source.times.get(place, ()), unit)
    history = empty_history(_time(stamps, request, source.path), channels)
    columns = [i for i in range(len(source.columns)) if i != place]
    readings, currents = bpm_labels(channels), corrector_labels(channels)
    devices = {i: _split(source.columns[i]) for i in columns}
    unknown = [each for each, _ in devices.values() if each not in readings | currents]
    if unknown:
        places_of(unknown, readings | currents, "columns", source.path)
    for into, labels, what, units, stated, option in (
        (history.orbit, readings, "BPMs", ORBIT, request.orbit_unit, "--orbit-unit"),
        (history.setpoints, currents, "correctors", CURRENT, request.setpoint_unit,
         "--setpoint-unit"),
    ):  # fmt: skip
        its = {i: each for i, each in devices.items() if each[0] in labels}
        kind = "orbit" if what == "BPMs" else "setpoints"
        factors = [
            factor(stated, written, units, f"{source.path}: {kind}", option)[1]
            for _, written in its.values()
        ]
        into[:, places_of([each for each, _ in its.values()], labels, what, source.path)] = (
            source.values[:, list(its)] * factors
        )
    return history


def _split(head: str) -> tuple[str, str]:
    """Take the unit in brackets off the head of a column: `PH1A_C02 [mm]`."""
    name, bracket, unit = head.rpartition("[")
    return (name.strip(), unit.rstrip("] ")) if bracket and head.endswith("]") else (head, "")


def _from_arrays(request: HistoryRequest, source: Source, channels: Channels) -> History:
    for where, option in (
        (request.time, "--time"), (request.orbit, "--orbit"), (request.setpoints, "--setpoints"),
    ):  # fmt: skip
        if where is None:
            raise ExchangeError(
                f"{source.path}: {option} must say where it is (there are: "
                f"{', '.join(source.listing()[:30])})"
            )
    found = source.get(str(request.time))
    time = _time(found, request, source.path)
    history = empty_history(time, channels)
    for into, where, names, labels, what, units, stated, option in (
        (history.orbit, request.orbit, request.bpm_names, bpm_labels(channels), "BPMs", ORBIT,
         request.orbit_unit, "--orbit-unit"),
        (history.setpoints, request.setpoints, request.corrector_names,
         corrector_labels(channels), "correctors", CURRENT, request.setpoint_unit,
         "--setpoint-unit"),
    ):  # fmt: skip
        found = source.get(str(where))
        matrix = matrix_of(found, source.path)
        if matrix.shape[0] != len(time):
            turned = matrix.shape[1] == len(time)
            raise ExchangeError(
                f"{source.path}: {found.where} has shape {matrix.shape}, there are {len(time)} "
                f"times; give one row per tick{' (it is transposed)' if turned else ''}"
            )
        _, size = factor(stated, found.units, units, f"{source.path}: {found.where}", option)
        places = _columns(request, source, matrix.shape[1], names, labels, what, into.shape[1])
        into[:, places] = np.where(np.isfinite(matrix), matrix * size, np.nan)
    return history


def _columns(
    request: HistoryRequest, source: Source, count: int, where: str | None,
    labels: dict[str, int], what: str, total: int,
) -> Any:  # fmt: skip
    if request.order == "table" and where is None:
        if count != total:
            raise ExchangeError(
                f"{source.path}: {count} {what}, the ring has {total}; give their names"
            )
        return np.arange(total)
    option = "--bpm-names" if what == "BPMs" else "--corrector-names"
    if where is None:
        raise ExchangeError(
            f"{source.path}: nothing says which {what} these are, and the order is not guessed; "
            f"give {option}, or --order table if they stand in the order of the places table"
        )
    names = names_from(source, where)
    if len(names) != count:
        raise ExchangeError(f"{source.path}: {len(names)} {what} for {count} columns")
    return places_of(names, labels, what, source.path)


def _from_archiver(
    request: HistoryRequest, channels: Channels, slow: Mapping[str, tuple[str, float]]
) -> tuple[History, dict[str, Any]]:
    pvs = read_archiver(request.files)
    known = {*channels.orbit_pvs, *channels.setpoint_pvs, *channels.readback_pvs}
    known |= {pv for pv, _ in slow.values()}
    if unknown := [name for name in pvs if name not in known]:
        places_of(unknown, dict.fromkeys(known, 0), "PVs", request.files[0])
    bpms = {i: pvs[pv] for i, pv in enumerate(channels.orbit_pvs) if pv in pvs}
    if not bpms:
        raise ExchangeError(f"{request.files[0]}: no PV of a BPM; ask the archiver for them too")
    ticks, small = find_ticks([*bpms.values()], request.tolerance)
    history = empty_history(ticks / _NANO, channels)
    for place, samples in bpms.items():
        size = _size(samples, request.orbit_unit, ORBIT, "--orbit-unit")
        history.orbit[:, place] = at_ticks(samples, ticks, request.tolerance) * size
    readback = np.full_like(history.setpoints, np.nan)
    for into, names in ((history.setpoints, channels.setpoint_pvs),
                        (readback, channels.readback_pvs)):  # fmt: skip
        for place, pv in enumerate(names):
            if pv in pvs:
                size = _size(pvs[pv], request.setpoint_unit, CURRENT, "--setpoint-unit")
                into[:, place] = in_force(pvs[pv], ticks, request.hold) * size
    auxiliary = {
        name: in_force(pvs[pv], ticks, None) * scale
        for name, (pv, scale) in slow.items()
        if pv in pvs
    }
    known_readback = np.isfinite(readback).any()
    history = replace(history, auxiliary=auxiliary, readback=readback if known_readback else None)
    return history, {"pvs": len(pvs), "stamps_without_a_tick": small}


def _size(samples: Samples, stated: str | None, units: Mapping[str, float], option: str) -> float:
    return factor(stated, samples.unit, units, samples.name, option)[1]

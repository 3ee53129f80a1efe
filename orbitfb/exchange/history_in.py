"""Read orbit histories: arrays of one file, a table of named columns, or an archiver's answer."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels, Vector
from orbitfb.exchange.align import at_ticks, find_ticks, in_force
from orbitfb.exchange.archiver import Samples, read_archiver
from orbitfb.exchange.csv_file import CsvSource
from orbitfb.exchange.found import Source, column_of, matrix_of
from orbitfb.exchange.history import History, empty_history
from orbitfb.exchange.naming import bpm_labels, corrector_labels, places_of
from orbitfb.exchange.source import names_from, open_source
from orbitfb.exchange.units import CURRENT, ORBIT, TIME, factor

_EPOCH_OF_DATENUM = 719_529.0
"""1970-01-01 in days of MATLAB's datenum."""

_NANO = 1e9


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


def _time(numbers: Vector, written: str, stated: str | None, what: str) -> Vector:
    unit, size = factor(stated, written, TIME, what, "--time-unit")
    return (numbers - _EPOCH_OF_DATENUM) * size if unit == "datenum" else numbers * size


def _from_table(request: HistoryRequest, source: CsvSource, channels: Channels) -> History:
    """Take the columns that are named as devices of the ring; the others must be few and known."""
    name = request.time or "time"
    if name not in source.columns:
        raise ExchangeError(
            f"{source.path}: no column {name!r} for the time (there are: "
            f"{', '.join(source.columns[:10])} …); say which with --time"
        )
    if len(source.rows):
        raise ExchangeError(f"{source.path}: its rows have names; give numbers in every column")
    time = source.values[:, source.columns.index(name)]
    history = empty_history(_time(time, "", request.time_unit, f"{source.path}: {name}"), channels)
    devices = [each for each in source.columns if each != name]
    readings, currents = bpm_labels(channels), corrector_labels(channels)
    unknown = [each for each in devices if each not in readings and each not in currents]
    if unknown:
        places_of(unknown, readings | currents, "columns", source.path)
    _, size = factor(request.orbit_unit, "", ORBIT, f"{source.path}: orbit", "--orbit-unit")
    _put(history.orbit, source, [d for d in devices if d in readings], readings, "BPMs", size)
    _, size = factor(
        request.setpoint_unit, "", CURRENT, f"{source.path}: setpoints", "--setpoint-unit"
    )
    chosen = [d for d in devices if d in currents]
    _put(history.setpoints, source, chosen, currents, "correctors", size)
    return history


def _put(
    into: Vector, source: CsvSource, names: Sequence[str], labels: dict[str, int], what: str,
    size: float,
) -> None:  # fmt: skip
    places = places_of(names, labels, what, source.path)
    columns = [source.columns.index(name) for name in names]
    into[:, places] = source.values[:, columns] * size


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
    time = _time(column_of(found, source.path), found.units, request.time_unit,
                 f"{source.path}: {found.where}")  # fmt: skip
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

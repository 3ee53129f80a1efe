"""Make the bytes of a file of what was frozen."""

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from orbitfb import __version__
from orbitfb.core.signals import COUNTS, Channels, Mask, TickRecord
from orbitfb.history.columns import AUXILIARY, Columns, allocate, fill
from orbitfb.history.segment import STATES, unit_of
from orbitfb.observe.plain import dumps
from orbitfb.postmortem.content import (
    ABOUT,
    CONFIGURATION,
    LONGEST_EVENT,
    LONGEST_NAME,
    LONGEST_REASON,
    LONGEST_TEXT,
    MARGIN_UNITS,
    MORE,
    PHASES,
    SCHEMA_VERSION,
    plan,
)
from orbitfb.postmortem.frozen import Frozen

_AT_ONCE = 16
_KNOWN = {
    *("tick", "state", "reason", "reading", "reference", "setpoints", "requested", "dither"),
    *("applied", "scale", "written", "policy_id", "phases", "latency", "missed"),
}


def encode(
    frozen: Frozen,
    channels: Channels,
    counting: Mask,
    configuration: str,
    about: Mapping[str, Any],
    breathe: Callable[[], None] = lambda: None,
) -> memoryview:
    """Make the file of a post-mortem.

    Args:
        frozen: What was known.
        channels: The names behind the vectors.
        counting: BPMs that are not masked by configuration, shape (n,).
        configuration: The whole configuration, as TOML.
        about: What else there is to say about the run, made of what JSON knows.
        breathe: Called every few rows, so that other threads come to their turn.
    """
    columns, reasons = _columns(frozen, channels, breathe)
    cause = frozen.cause
    said = {
        **about,
        "program": f"orbitfb {__version__}",
        "trigger": cause.trigger,
        "time": cause.wall,
        "tick": cause.tick,
        "state": cause.state,
        "before": cause.before,
        "reason": cause.reason[:LONGEST_REASON],
        "planes": channels.planes,
        **{word: counts for word in COUNTS if (counts := getattr(channels, word))},
        "ticks": len(frozen.ticks),
        "policies": list(dict.fromkeys(tick.record.policy_id for tick in frozen.ticks)),
    }
    image = io.BytesIO()
    with h5py.File(image, "w", libver=("v110", "v110")) as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file[ABOUT] = _text(dumps(said), LONGEST_TEXT)
        file[CONFIGURATION] = _text(configuration, LONGEST_TEXT)
        for word in ("bpms", "correctors", "orbit_pvs", "setpoint_pvs", "readback_pvs"):
            file[f"channels/{word}"] = _texts(getattr(channels, word), LONGEST_NAME)
        file["channels/counting"] = counting
        file["reasons"] = _texts(reasons, LONGEST_REASON)
        file.create_group(AUXILIARY[:-1])
        for name, values in columns.items():
            made = _make(file, name, values)
            unit = MARGIN_UNITS.get(name)
            made.attrs["units"] = unit_of(name) if unit is None else unit
            breathe()
        for name, values in _more([tick.record for tick in frozen.ticks]).items():
            file[MORE + name] = values
        _write_events(file, frozen)
    return image.getbuffer()  # not a copy, for which all threads would wait


def _columns(
    frozen: Frozen, channels: Channels, breathe: Callable[[], None]
) -> tuple[Columns, list[str]]:
    """Give the columns, and the reasons that the column `reason` numbers."""
    readings = (tick.record.reading for tick in frozen.ticks)
    auxiliary = sorted({name for its in readings if its is not None for name in its.auxiliary})
    columns = allocate(plan(channels, auxiliary), len(frozen.ticks))
    reasons: dict[str, int] = {}
    for row, tick in enumerate(frozen.ticks):
        record = tick.record
        fill(columns, row, record)
        columns["since_trip"][row] = tick.monotonic - frozen.cause.monotonic
        columns["ended"][row] = tick.wall
        columns["phases"][row] = [getattr(record.phases, phase) for phase in PHASES]
        columns["reason"][row] = reasons.setdefault(record.reason, len(reasons))
        if row % _AT_ONCE == 0:
            breathe()
    return columns, list(reasons)


def _make(file: h5py.File, name: str, values: NDArray[Any]) -> h5py.Dataset:
    if name != "state":
        return file.create_dataset(name, data=values)
    kind = h5py.enum_dtype({str(state): number for number, state in enumerate(STATES)}, "u1")
    return file.create_dataset(name, data=values, dtype=kind)


def _write_events(file: h5py.File, frozen: Frozen) -> None:
    events = frozen.events
    since = [event.monotonic - frozen.cause.monotonic for event in events]
    file["events/since_trip"] = np.array(since, dtype=np.float64)
    file["events/time"] = np.array([event.wall for event in events], dtype=np.float64)
    file["events/level"] = _texts((event.level for event in events), LONGEST_NAME)
    file["events/name"] = _texts((event.name for event in events), LONGEST_NAME)
    file["events/fields"] = _texts((dumps(event.fields) for event in events), LONGEST_EVENT)


def _more(records: Sequence[TickRecord]) -> dict[str, NDArray[Any]]:
    """Give what a record holds beside the columns, by name."""
    found: dict[str, NDArray[Any]] = {}
    kind = records[0] if records else TickRecord
    for name in (field.name for field in fields(kind) if field.name not in _KNOWN):
        values = [getattr(record, name) for record in records]
        shapes = {np.shape(value) for value in values}
        numbers = all(isinstance(value, bool | int | float | np.ndarray) for value in values)
        whole = np.array(values) if numbers and len(shapes) == 1 else None
        if whole is not None and whole.dtype.kind in "biuf":
            found[name] = whole
        else:
            told = (value if isinstance(value, str) else dumps(value) for value in values)
            found[name] = _texts(told, LONGEST_REASON)
    return found


def _texts(values: Iterable[str], longest: int) -> NDArray[np.bytes_]:
    """Make texts of one length, cut where they are too long."""
    made = [value.encode(errors="replace")[:longest] for value in values]
    return np.array(made, dtype=f"S{max(map(len, made), default=1) or 1}")


def _text(value: str, longest: int) -> np.bytes_:
    return np.bytes_(value.encode(errors="replace")[:longest] or b" ")

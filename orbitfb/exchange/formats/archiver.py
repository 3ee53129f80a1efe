"""Read what the EPICS Archiver Appliance answers in JSON (`getData.json`, `getDataForPVs.json`).

A list with one object per PV: `meta` with its name, unit (EGU) and precision, and `data`, a list of
samples with `secs` since 1970 and `nanos`, `val`, alarm `severity` and `status`. The first sample
after a loss of the connection says so in `fields`: the value before it is not in force any more
from `cnxlostepsecs` on.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector
from orbitfb.exchange.formats.source import check_file

LARGEST_JSON = 2**29
"""Largest file that is read [bytes]; Python needs some ten times as much to take it apart."""

INVALID = 3
"""Alarm severity of a value that must not be used."""

_NANO = 1_000_000_000
_MOST_SAMPLES = 20_000_000
_LATEST = 2**33


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What one PV was, in the order of its stamps.

    Args:
        name: The PV.
        unit: As the archiver has it (EGU), or empty.
        stamps: Shape (k,) [ns since the epoch].
        values: Shape (k,); NaN where the severity is INVALID or the value is no number.
        lost: When its connection was lost, each time, shape (l,) [ns since the epoch].
    """

    name: str
    unit: str
    stamps: NDArray[np.int64]
    values: Vector
    lost: NDArray[np.int64]


def read_archiver(paths: Sequence[Path]) -> dict[str, Samples]:
    """Read answers of the archiver, of one PV or of many; a PV of several files is joined.

    Args:
        paths: The files.

    Returns:
        The samples by PV.

    Raises:
        ExchangeError: A file is no such answer, or too large.
    """
    parts: dict[str, list[Samples]] = {}
    for path in paths:
        for number, entry in enumerate(_entries(path)):
            samples = _samples(path, number, entry)
            parts.setdefault(samples.name, []).append(samples)
    return {name: _joined(each) for name, each in parts.items()}


def _entries(path: Path) -> list[Any]:
    check_file(path, LARGEST_JSON)
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError, MemoryError) as error:
        raise ExchangeError(
            f"{path}: no JSON ({str(error)[:200]}); save what getData.json answers as it comes"
        ) from error
    if not isinstance(content, list) or not content:
        raise ExchangeError(
            f"{path}: a list of {{meta, data}}, one for each PV, is expected, not "
            f"{'an empty list' if content == [] else type(content).__name__}; ask for .json, not "
            ".qw or .raw, and for PVs and times that there are"
        )
    return content


def _samples(path: Path, number: int, entry: Any) -> Samples:
    meta = entry.get("meta") if isinstance(entry, dict) else None
    data = entry.get("data") if isinstance(entry, dict) else None
    if not isinstance(meta, dict) or not isinstance(data, list):
        raise ExchangeError(f"{path}: entry {number} has no meta and data; see the answer's format")
    name, unit = meta.get("name"), meta.get("EGU") or ""
    if not isinstance(name, str) or not name or not isinstance(unit, str):
        raise ExchangeError(f"{path}: entry {number} does not name its PV in meta.name")
    if len(data) > _MOST_SAMPLES:
        raise ExchangeError(f"{path}: {name} has {len(data)} samples; ask for less time")
    stamps, values, lost = np.empty(len(data), np.int64), np.empty(len(data)), []
    for row, sample in enumerate(data):
        try:
            stamps[row] = _stamp(sample)
            values[row] = _value(sample)
            lost += _losses(sample)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ExchangeError(
                f"{path}: {name}, sample {row} cannot be read ({error!r}): "
                f"{json.dumps(sample)[:120]}; only scalar PVs are read"
            ) from error
    return Samples(name, unit, stamps, values, np.array(lost, dtype=np.int64))


def _stamp(sample: Mapping[str, Any]) -> int:
    seconds, nanos = int(sample["secs"]), int(sample.get("nanos", 0))
    if not (0 <= seconds < _LATEST and 0 <= nanos < _NANO):
        raise ValueError("its stamp is out of range")
    return seconds * _NANO + nanos


def _value(sample: Mapping[str, Any]) -> float:
    """Give the value; NaN when it must not be used, or is null, as archivers write NaN."""
    value = sample["val"]
    if value is None or int(sample.get("severity") or 0) >= INVALID:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError(f"val is a {type(value).__name__}")
    number = float(value)  # the archiver writes "NaN" and "Infinity" as text
    return number if math.isfinite(number) else math.nan


def _losses(sample: Mapping[str, Any]) -> Iterable[int]:
    fields = sample.get("fields", {})
    seconds = fields.get("cnxlostepsecs") if isinstance(fields, dict) else None
    return () if seconds is None else (int(seconds) * _NANO,)


def _joined(parts: Sequence[Samples]) -> Samples:
    """Put samples in the order of their stamps; what is there twice counts once."""
    if len({part.unit for part in parts if part.unit}) > 1:
        raise ExchangeError(
            f"{parts[0].name} has the units {', '.join(sorted({p.unit for p in parts}))} in "
            "different files; correct the one that is wrong"
        )
    stamps = np.concatenate([part.stamps for part in parts])
    values = np.concatenate([part.values for part in parts])
    order = np.argsort(stamps, kind="stable")
    kept = order[np.append(np.diff(stamps[order]) > 0, True)] if len(order) else order
    unit = next((part.unit for part in parts if part.unit), "")
    lost = np.unique(np.concatenate([part.lost for part in parts]))
    return Samples(parts[0].name, unit, stamps[kept], values[kept], lost)

"""The figures of the last diagnosis of the service's own archive, for who scrapes."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog

from orbitfb.core.errors import RecordError
from orbitfb.core.files.bounded import LARGEST_DIAGNOSIS, parse_json, read_bytes

FILE = Path("archive.diagnosis/diagnosis.json")
"""Where `orbitfb diagnose DATA/archive` writes, below the data directory."""

_log = structlog.stdlib.get_logger("orbitfb.observe")


@dataclass(frozen=True, slots=True)
class DiagnosisFigures:
    """What a diagnosis came to; NaN where it says nothing.

    Args:
        time: When its file was written [s since the epoch].
        nats: The gap that it found [nats/tick].
        shrink: Share of the gap that goes with the causes in the model [1].
        low: Lower end of its 90 % interval [1].
        high: Upper end [1].
    """

    time: float
    nats: float
    shrink: float
    low: float
    high: float


class LastDiagnosis:
    """Reads the file again when it has changed; one that cannot be read is told of and left out.

    Args:
        directory: Data directory of the service.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / FILE
        self._seen: tuple[int, int] | None = None
        self._figures: DiagnosisFigures | None = None

    def __call__(self) -> DiagnosisFigures | None:
        """Return the figures; None while there is no diagnosis."""
        try:
            status = self._path.stat()
        except OSError:
            self._seen = self._figures = None
            return None
        seen = (status.st_mtime_ns, status.st_size)
        if seen != self._seen:
            self._seen = seen
            try:
                self._figures = _figures(self._path, status.st_mtime)
            except RecordError as error:
                self._figures = None
                _log.warning("diagnosis_unreadable", problem=str(error))
        return self._figures


def _figures(path: Path, written: float) -> DiagnosisFigures:
    advice = "diagnose again, or remove it"
    content = read_bytes(path, LARGEST_DIAGNOSIS, RecordError, advice)
    answer = parse_json(content, path, RecordError)
    if not isinstance(answer, Mapping):
        raise RecordError(f"{path}: is no diagnosis; {advice}")
    shrink = _part(answer, "shrink")
    return DiagnosisFigures(
        time=written,
        nats=_number(_part(answer, "gap").get("nats_per_tick")),
        shrink=_number(shrink.get("nats")),
        low=_number(shrink.get("low")),
        high=_number(shrink.get("high")),
    )


def _part(answer: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = answer.get(key)
    return part if isinstance(part, Mapping) else {}


def _number(value: object) -> float:
    known = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if known else math.nan

"""What a measurement keeps on disk while it runs, so that a kill leaves nothing astray.

    DIRECTORY/moved.json            correctors that are away from where they were found, and where
                                    that was: there before the first of them moves, gone when all
                                    are back
    DIRECTORY/columns.safetensors   columns that are done

Both are replaced whole: a reader sees the old or the new, also after a kill or a power cut.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from orbitfb.core.errors import MeasurementError, StoreError
from orbitfb.core.files.state import make_directory
from orbitfb.core.files.whole import read_bounded, replace_file
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Channels, Vector
from orbitfb.measure.column import Table, table_shapes
from orbitfb.measure.packed import read_packed, write_packed

_KIND = "columns"
_LARGEST = 2**22


class _Moved(Settings):
    schema_version: int = Field(default=1, ge=1, le=1)
    where: str
    time: float
    setpoint_pvs: tuple[str, ...]
    setpoints: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """Correctors that a measurement moved and, as far as is known, did not put back.

    Args:
        where: The ring.
        time: When they were moved [s since the epoch].
        setpoint_pvs: PVs of their setpoints, k of them.
        setpoints: Where they were found, shape (k,) [A].
    """

    where: str
    time: float
    setpoint_pvs: tuple[str, ...]
    setpoints: Vector


class Journal:
    """Keeps what is moved and what is done.

    Args:
        directory: Its own directory; it is made when something is first written.
        channels: Of the ring.
        where: The ring.
    """

    def __init__(self, directory: Path, channels: Channels, where: str) -> None:
        self._channels, self._where = channels, where
        self.directory = directory
        self._moved = directory / "moved.json"
        self._columns = directory / "columns.safetensors"

    def mark(self, correctors: Sequence[int], base: Vector, time: float) -> None:
        """Say which correctors are about to move.

        Args:
            correctors: Their indices.
            base: Setpoints that were found, shape (m,) [A].
            time: Now [s since the epoch].

        Raises:
            MeasurementError: It cannot be written; then nothing may be moved.
        """
        content = _Moved(
            where=self._where,
            time=time,
            setpoint_pvs=tuple(self._channels.setpoint_pvs[j] for j in correctors),
            setpoints=tuple(float(base[j]) for j in correctors),
        )
        self._write(self._moved, content.model_dump_json(indent=1).encode())

    def clear(self) -> None:
        """Say that all correctors are back.

        Raises:
            MeasurementError: The file cannot be removed; the next start finds nothing astray.
        """
        try:
            self._moved.unlink(missing_ok=True)
        except OSError as error:
            raise MeasurementError(
                f"{self._moved} cannot be removed ({error.strerror}); repair that directory. The "
                "setpoints are where they were"
            ) from error

    def moved(self) -> Moved | None:
        """Tell what was moved and not put back; None: nothing.

        Raises:
            MeasurementError: The file is damaged.
        """
        if not self._moved.exists():
            return None
        advice = f"put the setpoints back by hand and remove {self._moved}"
        try:
            text = read_bounded(self._moved, _LARGEST, advice)
        except StoreError as error:
            raise MeasurementError(f"{self._moved}: {error}") from error
        try:
            found = _Moved.model_validate_json(text)
        except ValidationError as error:
            raise MeasurementError(self._damaged(_first_problem(error), text)) from None
        if len(found.setpoint_pvs) != len(found.setpoints):
            names, values = len(found.setpoint_pvs), len(found.setpoints)
            problem = f"it names {names} PVs for {values} setpoints"
            raise MeasurementError(self._damaged(problem, text))
        return Moved(found.where, found.time, found.setpoint_pvs, np.array(found.setpoints))

    def _damaged(self, problem: str, text: bytes) -> str:
        """Say what is wrong, and what to do with setpoints that nobody knows for certain."""
        pvs = sorted({pv for pv in self._channels.setpoint_pvs if pv.encode() in text})
        named = f"; it names {', '.join(pvs[:5])}{' and others' if len(pvs) > 5 else ''}"
        return (
            f"{self._moved} is damaged: {problem}. It tells where setpoints were before a "
            f"measurement moved them{named if pvs else ''}; compare the setpoints with the "
            "archive, put back by hand what differs, then remove the file"
        )

    def save(self, table: Table, conditions: dict[str, Any]) -> None:
        """Keep the columns that are done.

        Args:
            table: The columns.
            conditions: Under which they are measured; only what JSON can say.

        Raises:
            MeasurementError: It cannot be written.
        """
        self._make()
        write_packed(self._columns, table.tensors(), self._card(conditions))

    def load(self, conditions: dict[str, Any], oldest: float) -> Table | None:
        """Take up the columns that are done; None: there are none.

        Args:
            conditions: Under which columns are measured now.
            oldest: Columns from before are too old [s since the epoch].

        Raises:
            MeasurementError: They are of another ring, other conditions, too old, or damaged.
        """
        if not self._columns.exists():
            return None
        advice = "begin anew with --fresh"
        tensors, card = read_packed(self._columns, _KIND, advice, MeasurementError)
        wanted = json.loads(json.dumps(self._card(conditions)))
        other = [key for key, value in wanted.items() if card.get(key) != value]
        if other:
            raise MeasurementError(
                f"the measurement that was begun in {self.directory} differs in "
                f"{', '.join(other)}; finish it as it was begun, or {advice}"
            )
        n, m = len(self._channels.bpms), len(self._channels.correctors)
        if {name: tensor.shape for name, tensor in tensors.items()} != table_shapes(n, m):
            raise MeasurementError(f"{self._columns} holds other arrays; {advice}")
        table = Table.of(tensors)
        first = np.nanmin(table.time) if table.measured.any() else np.inf
        if first < oldest:
            raise MeasurementError(
                f"the measurement that was begun in {self.directory} is too old "
                f"(measure.resume_within): the ring may have drifted since; {advice}"
            )
        return table

    def forget(self) -> None:
        """Drop the columns."""
        self._columns.unlink(missing_ok=True)

    def _card(self, conditions: dict[str, Any]) -> dict[str, Any]:
        names = {
            "planes": self._channels.planes,
            "bpms": self._channels.bpms,
            "correctors": self._channels.correctors,
        }
        return {"kind": _KIND, "ring": self._where, **names, **conditions}

    def _make(self) -> None:
        try:
            make_directory(self.directory)
        except OSError as error:
            raise MeasurementError(
                f"{self.directory} cannot be made ({error.strerror}); name another data directory"
            ) from error

    def _write(self, path: Path, content: bytes) -> None:
        self._make()
        try:
            replace_file(path, content)
        except OSError as error:
            raise MeasurementError(
                f"{path} cannot be written ({error.strerror}); nothing was moved"
            ) from error


def _first_problem(error: ValidationError) -> str:
    """Say in words what is wrong with a file of JSON, and where."""
    first = error.errors()[0]
    if first["type"] == "json_invalid":
        where = re.search(r"line (\d+) column (\d+)", first["msg"])
        place = f" (line {where[1]}, column {where[2]})" if where else ""
        return f"it is no whole JSON{place}"
    key = ".".join(map(str, first["loc"]))
    if not key:
        return "it holds something else than a record of moved setpoints"
    kinds = {"missing": "is missing", "extra_forbidden": "does not belong there"}
    return f"`{key}` {kinds.get(first['type'], 'has a wrong value')}"

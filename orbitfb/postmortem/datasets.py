"""Take arrays from a file that anybody may have made: nothing is read before its size is known."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RecordError

LARGEST_CHUNK = 2**26

_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
_ADVICE = "it is not as orbitfb wrote it: take it from a backup"


class Datasets:
    """The datasets of one open file.

    Args:
        file: The file.
        path: Its name, for errors.
        largest: Most that may be read of it [bytes].
    """

    def __init__(self, file: h5py.File, path: Path, largest: int) -> None:
        self._file, self._path, self._left = file, path, largest

    def wrong(self, array: str, problem: str, row: int | None = None) -> RecordError:
        """Make the error about an array, and a row of it."""
        where = f"array '{array}'" + ("" if row is None else f", row {row}")
        return RecordError(f"{self._path}: {where} {problem}; {_ADVICE}")

    def has(self, name: str) -> bool:
        """Tell whether something of that name is in the file."""
        return name in self._file

    def names(self, group: str, most: int) -> list[str]:
        """List the datasets of a group.

        Raises:
            RecordError: There is no such group, or it has more than that.
        """
        found = self._file.get(group) if self._is_here(group) else None
        if not isinstance(found, h5py.Group) or len(found) > most:
            raise self.wrong(group, f"is no group of at most {most} arrays")
        return [str(name) for name in found]

    def read(self, name: str, shape: tuple[int, ...], kind: np.dtype[Any]) -> NDArray[Any]:
        """Read numbers.

        Args:
            name: Of the dataset.
            shape: That it must have.
            kind: Type that it must have.

        Raises:
            RecordError: It is not there, is something else, or too large.
        """
        found = self._find(name)
        if found.shape != shape or found.dtype != kind:
            raise self.wrong(
                name,
                f"has shape {found.shape} and type {found.dtype}, expected were {shape} and {kind}",
            )
        return self._take(name, found)

    def texts(self, name: str, most: int, longest: int) -> tuple[str, ...]:
        """Read texts of a fixed length.

        Args:
            name: Of the dataset.
            most: Of them at most.
            longest: Longest one [bytes].

        Raises:
            RecordError: It is not there, is something else, or too large.
        """
        found = self._find(name)
        if (
            len(found.shape) > 1
            or (found.size or 0) > most
            or found.dtype.kind != "S"
            or found.dtype.itemsize > longest
        ):
            raise self.wrong(
                name,
                f"has shape {found.shape} and type {found.dtype}, expected were at most {most} "
                f"texts of {longest} bytes",
            )
        values = np.atleast_1d(self._take(name, found))
        return tuple(bytes(value).decode(errors="replace") for value in values)

    def mapping(self, name: str, longest: int) -> Mapping[str, Any]:
        """Read a JSON object.

        Raises:
            RecordError: It is not there, or something else.
        """
        texts = self.texts(name, 1, longest)
        try:
            found = json.loads(texts[0]) if texts else None
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict):
            raise self.wrong(name, "is no JSON object")
        return found

    def shape(self, name: str) -> tuple[tuple[int, ...], np.dtype[Any]]:
        """Give shape and type of a dataset.

        Raises:
            RecordError: It is not there.
        """
        found = self._find(name)
        return found.shape, found.dtype

    def _is_here(self, name: str) -> bool:
        """Whether a name, and every group on the way, is a part of this very file."""
        parts = name.split("/")
        return all(
            isinstance(self._file.get("/".join(parts[:end]), getlink=True), h5py.HardLink)
            for end in range(1, len(parts) + 1)
        )

    def _find(self, name: str) -> h5py.Dataset:
        found = self._file.get(name) if self._is_here(name) else None
        if not isinstance(found, h5py.Dataset) or found.shape is None:
            raise self.wrong(name, "is missing")
        if found.is_virtual or found.external:
            raise self.wrong(name, "lies in another file")
        made = found.id.get_create_plist()
        filters = {made.get_filter(number)[0] for number in range(made.get_nfilters())}
        if not filters <= _FILTERS:
            raise self.wrong(name, "is packed by an unknown filter")
        if found.chunks is not None:
            size = int(np.prod(found.chunks, dtype=object)) * found.dtype.itemsize
            if size > LARGEST_CHUNK:
                raise self.wrong(name, f"has chunks of {size} bytes")
        return found

    def _take(self, name: str, found: h5py.Dataset) -> NDArray[Any]:
        size = int(np.prod(found.shape, dtype=object)) * found.dtype.itemsize
        if size > self._left:
            raise self.wrong(name, f"takes {size} bytes, {self._left} are left of what is allowed")
        self._left -= size
        return np.asarray(found[()])

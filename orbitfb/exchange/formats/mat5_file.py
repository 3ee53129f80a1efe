"""Read arrays and names from MATLAB's `.mat` up to version 7 (what MATLAB saves by default).

`scipy.io.loadmat` runs nothing of a file, but unpacks all of it: how much that will be is counted
first, element by element, with a bound on the way.
"""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatReadError

from orbitfb.core.errors import ExchangeError
from orbitfb.exchange.formats.datasets import (
    LARGEST_ARRAY,
    UNITS_BESIDE,
    Found,
    absent,
    check_text,
    offset,
    steps_of,
)

_HEADER = 128
_COMPRESSED = 15
_PIECE = 2**20
_DAMAGE = (
    OSError, ValueError, TypeError, KeyError, IndexError, AttributeError, NotImplementedError,
    OverflowError, RecursionError, MemoryError, EOFError, struct.error, zlib.error,
    AssertionError, UnicodeError, NameError, MatReadError,
)  # fmt: skip
"""All that scipy raises over a damaged file."""


class Mat5Source:
    """A `.mat` file up to version 7.

    Args:
        path: The file.
        largest: Most that it may unpack to [bytes].

    Raises:
        ExchangeError: It is none, is damaged, or unpacks to more.
    """

    def __init__(self, path: Path, largest: int = LARGEST_ARRAY) -> None:
        self._path = path
        self._read: dict[str, Any] = {}
        try:
            _check_unpacked(path, largest)
            self._variables = {name: (shape, kind) for name, shape, kind in whosmat(path)}
        except _DAMAGE as error:
            raise self._damaged(error) from error

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def listing(self) -> tuple[str, ...]:
        """Name the variables, and the fields of those structs that were read."""
        names: list[str] = []
        for name in self._variables:
            fields = self._variable(name).dtype.names
            names += [f"{name}.{field}" for field in fields] if fields else [name]
        return tuple(names)

    def get(self, where: str) -> Found:
        """Read what lies under a path; `units` is the field of that name beside it."""
        first, *rest = steps_of(where)
        if first.name not in self._variables:
            raise absent(self, where)
        here: Any = self._variable(first.name)
        index, units = first.index, ""
        for step in rest:
            fields = getattr(here, "dtype", np.dtype("f8")).names
            if not fields or step.name not in fields:
                raise absent(self, where)
            element = here[offset(here.shape, index, where)]
            for beside in UNITS_BESIDE:
                if beside in fields and step.name != beside:
                    units = "".join(_texts(element[beside]) or ("",))
            here, index = element[step.name], step.index
        return self._found(here, index, where, units)

    def _found(self, here: Any, index: tuple[int, ...], where: str, units: str) -> Found:
        array = np.asarray(here)
        if array.dtype.names:
            raise ExchangeError(
                f"{self._path}: {where} is a struct of {', '.join(array.dtype.names)}; name one "
                f"of them, as in {where}.{array.dtype.names[0]}"
            )
        if index and array.dtype == object:
            array = np.asarray(array[offset(array.shape, index, where)])
        texts = _texts(array)
        if texts is not None:
            check_text(self._path, where, len(texts), max(map(len, texts), default=0))
            return Found(where, np.empty(0), texts, units)
        if array.dtype.kind not in "fiub":
            raise ExchangeError(
                f"{self._path}: {where} holds neither real numbers nor names ({array.dtype})"
            )
        return Found(where, np.asarray(array, dtype=np.float64), (), units)

    def _variable(self, name: str) -> Any:
        if name not in self._read:
            try:
                self._read |= loadmat(self._path, variable_names=[name], mat_dtype=False)
            except _DAMAGE as error:
                raise self._damaged(error) from error
        return self._read[name]

    def _damaged(self, error: BaseException) -> ExchangeError:
        return ExchangeError(
            f"{self._path}: no readable .mat file ({str(error)[:200] or type(error).__name__}); "
            "save it again, with -v7 or -v7.3"
        )


def _texts(array: Any) -> tuple[str, ...] | None:
    """Give the texts of a char array or of a cell of them; None when it is something else."""
    array = np.asarray(array)
    if array.dtype.kind == "U":
        return tuple(str(text).rstrip() for text in array.reshape(-1))
    if array.dtype != object or not array.size:
        return None
    texts: list[str] = []
    for cell in array.reshape(-1):
        inner = np.asarray(cell)
        if inner.dtype.kind != "U" or inner.size > 1:
            return None
        texts.append(str(inner.reshape(-1)[0]) if inner.size else "")
    return tuple(texts)


def _check_unpacked(path: Path, largest: int) -> None:
    """Count what the elements of the file unpack to, without keeping it.

    Raises:
        ExchangeError: More than allowed.
        ValueError: It is no such file.
    """
    total = 0
    with path.open("rb") as file:
        header = file.read(_HEADER)
        if len(header) < _HEADER or header[126:128] not in (b"IM", b"MI"):
            raise ValueError("it does not begin as a .mat file of version 5 does")
        order = "<" if header[126:128] == b"IM" else ">"
        while tag := file.read(8):
            kind, length = struct.unpack(f"{order}II", tag)
            total += length if kind != _COMPRESSED else _inflated(file, length, largest - total)
            if kind != _COMPRESSED:
                file.seek(length, 1)
            if total > largest:
                raise ExchangeError(
                    f"{path}: unpacks to more than the {largest} bytes allowed; nothing was "
                    "unpacked; save the matrix alone"
                )


def _inflated(file: Any, length: int, most: int) -> int:
    """Count the bytes that a compressed element unpacks to; stops once there are too many."""
    machine, count, left = zlib.decompressobj(), 0, length
    while left > 0 and count <= most:
        piece = file.read(min(_PIECE, left))
        if not piece:
            raise EOFError("it ends in the middle of an element")
        left -= len(piece)
        while piece and count <= most:
            count += len(machine.decompress(piece, _PIECE))
            piece = machine.unconsumed_tail
    return count

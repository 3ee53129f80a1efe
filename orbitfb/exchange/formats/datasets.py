"""What foreign files hold, by one set of words whatever their format, and how much is read."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Vector

LARGEST_FILE = 2 * 2**30
"""Largest file that is opened [bytes]."""

LARGEST_ARRAY = 2**30
"""Most that one array may take in memory [bytes]."""

UNITS_BESIDE = ("units", "UnitsString")
"""Fields beside a matrix that say its unit; the last is that of the Matlab Middle Layer."""

MOST_NAMES = 20_000
LONGEST_NAME = 256
MOST_DIMENSIONS = 3
_MOST_LISTED = 30
_STEP = re.compile(r"([^.()/]+)(?:\((\d{1,6})(?:,(\d{1,6}))?\))?")


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What lies under one path of a file: numbers or texts.

    Args:
        where: The path within the file, for messages.
        numbers: As they stand in the file, rows first; empty when it holds texts.
        texts: Names; empty when it holds numbers.
        units: What the file itself says of the unit; empty when it says nothing.
    """

    where: str
    numbers: Vector
    texts: tuple[str, ...] = ()
    units: str = ""


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a path: a name, and an index counted from 1 as MATLAB counts.

    Args:
        name: Of a variable, a field, a group or a dataset.
        index: Row and column, or one number along both; empty when none is given.
    """

    name: str
    index: tuple[int, ...]


class Source(Protocol):
    """A foreign file that is open for reading."""

    @property
    def path(self) -> Path:
        """The file."""
        ...

    def listing(self) -> tuple[str, ...]:
        """Name what there is, for messages; bounded."""
        ...

    def get(self, where: str) -> Found:
        """Read what lies under a path.

        Raises:
            ExchangeError: There is nothing, it is too large, or neither numbers nor texts.
        """
        ...


def steps_of(where: str) -> list[Step]:
    """Take a path apart: `RM.data`, `RM/data`, `Rmat(1,2).Data`.

    Raises:
        ExchangeError: That is no path.
    """
    parts = re.split(r"[./](?![^(]*\))", where.strip("/"))
    found: list[Step] = []
    for part in parts:
        match = _STEP.fullmatch(part)
        if match is None:
            raise ExchangeError(
                f"{where!r} is no path within a file; give names with dots between them, as in "
                "RM.data or Rmat(1,2).Data"
            )
        found.append(Step(match[1], tuple(int(part) for part in match.groups()[1:] if part)))
    return found


def offset(shape: tuple[int, ...], index: Sequence[int], where: str) -> tuple[int, ...]:
    """Turn an index counted from 1 into one counted from 0, within a shape (rows, columns).

    Raises:
        ExchangeError: It is beyond the shape, or one is needed and none is given.
    """
    size = 1
    for length in shape:
        size *= length
    if not index and size == 1:
        return (0,) * len(shape)
    if not index:
        raise ExchangeError(
            f"{where} is an array of {' x '.join(map(str, shape))}; say which, as in (1,1)"
        )
    if len(index) == 1 and len(shape) == 2:  # column by column, as MATLAB counts
        index = ((index[0] - 1) % max(shape[0], 1) + 1, (index[0] - 1) // max(shape[0], 1) + 1)
    if len(index) != len(shape) or any(
        not 1 <= place <= length for place, length in zip(index, shape, strict=True)
    ):
        raise ExchangeError(
            f"{where}: there is no element ({','.join(map(str, index))}), it has "
            f"{' x '.join(map(str, shape))}; counting begins with 1"
        )
    return tuple(place - 1 for place in index)


def absent(source: Source, where: str) -> ExchangeError:
    """Make the error for a path under which there is nothing."""
    there = source.listing()
    hint = did_you_mean(where, there, most=1)
    shown = ", ".join(there[:_MOST_LISTED]) or "nothing"
    more = f" and {len(there) - _MOST_LISTED} more" if len(there) > _MOST_LISTED else ""
    return ExchangeError(f"{source.path}: there is no {where!r}{hint} (there are: {shown}{more})")


def check_size(path: Path, where: str, shape: tuple[int, ...], itemsize: int) -> None:
    """Refuse an array by its header alone.

    Raises:
        ExchangeError: It has too many dimensions or takes too much.
    """
    size = itemsize
    for length in shape:
        size *= int(length)  # Python's integers do not overflow
    if len(shape) > MOST_DIMENSIONS:
        raise ExchangeError(f"{path}: {where} has {len(shape)} dimensions; give a matrix")
    if size > LARGEST_ARRAY:
        raise ExchangeError(
            f"{path}: {where} of shape {shape} takes {size} bytes, {LARGEST_ARRAY} are allowed; "
            "cut it into pieces"
        )


def check_text(path: Path, where: str, count: int, longest: int) -> None:
    """Refuse texts that are no list of names.

    Raises:
        ExchangeError: There are too many, or they are too long.
    """
    if count > MOST_NAMES or longest > LONGEST_NAME:
        raise ExchangeError(
            f"{path}: {where} holds {count} texts of up to {longest} characters; at most "
            f"{MOST_NAMES} names of {LONGEST_NAME} are read"
        )


def matrix_of(found: Found, path: Path) -> Vector:
    """Give numbers in two dimensions.

    Raises:
        ExchangeError: It holds texts, or more or less than a matrix.
    """
    if found.texts or found.numbers.ndim != 2 or 0 in found.numbers.shape:
        what = "names" if found.texts else f"numbers of shape {found.numbers.shape}"
        raise ExchangeError(f"{path}: {found.where} holds {what}; a matrix of numbers is needed")
    return found.numbers


def column_of(found: Found, path: Path) -> Vector:
    """Give numbers in one dimension; a single row or column counts as one.

    Raises:
        ExchangeError: It holds texts or a matrix.
    """
    numbers = found.numbers
    if found.texts or numbers.size == 0 or max(numbers.shape, default=0) != numbers.size:
        what = "names" if found.texts else f"numbers of shape {numbers.shape}"
        raise ExchangeError(f"{path}: {found.where} holds {what}; one row or column is needed")
    return numbers.reshape(-1)


def names_of(found: Found, path: Path) -> tuple[str, ...]:
    """Give names.

    Raises:
        ExchangeError: It holds numbers.
    """
    if not found.texts:
        raise ExchangeError(
            f"{path}: {found.where} holds numbers, not names; name where the names are, or give "
            "a text file of them as @FILE"
        )
    return tuple(text.strip() for text in found.texts)

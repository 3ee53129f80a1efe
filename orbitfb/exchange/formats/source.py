"""Open a file from elsewhere: which format it is, how large, and the names beside it."""

import stat
from pathlib import Path

import h5py

from orbitfb.core.errors import ExchangeError
from orbitfb.core.files.bounded import read_text
from orbitfb.core.files.delimited import MARKS
from orbitfb.exchange.formats.csv_file import CsvSource
from orbitfb.exchange.formats.datasets import LARGEST_FILE, Source, check_text, names_of
from orbitfb.exchange.formats.hdf5_file import Hdf5Source
from orbitfb.exchange.formats.mat5_file import Mat5Source

_HDF5 = (".h5", ".hdf5", ".hdf")
_CSV = (".csv", ".tsv", ".txt")
_LARGEST_LIST = 2**22


def open_source(path: Path) -> Source:
    """Open a file by its suffix; a `.mat` is of version 7.3 when it is HDF5 inside.

    Raises:
        ExchangeError: It cannot be read, is too large, damaged, or of no format that is known.
    """
    check_file(path, LARGEST_FILE)
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return Hdf5Source(path) if h5py.is_hdf5(path) else Mat5Source(path)
    if suffix in _HDF5:
        return Hdf5Source(path)
    if suffix in _CSV:
        return CsvSource(path)
    raise ExchangeError(
        f"{path}: files that end in {', '.join((*_HDF5, *_CSV, '.mat'))} are read, not in "
        f"{suffix or 'nothing'!r}; save it as one of them"
    )


def check_file(path: Path, largest: int) -> None:
    """See that a path is a plain file of a sane size, before it is opened.

    Raises:
        ExchangeError: It is not.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ExchangeError(f"{path}: cannot be read ({reason}); correct the path") from error
    if not stat.S_ISREG(status.st_mode):
        raise ExchangeError(f"{path}: no plain file; name a file")
    if not 0 < status.st_size <= largest:
        raise ExchangeError(
            f"{path}: has {status.st_size} bytes, from 1 to {largest} are read; "
            + ("copy it again" if not status.st_size else "cut it into pieces")
        )


def names_from(source: Source, where: str) -> tuple[str, ...]:
    """Read names: from a path within the source, or `@FILE`, a text file with one per line.

    Raises:
        ExchangeError: There are none.
    """
    if not where.startswith("@"):
        return names_of(source.get(where), source.path)
    return names_listed(Path(where[1:]))


def names_listed(path: Path) -> tuple[str, ...]:
    """Read names of a text file with one per line.

    Raises:
        ExchangeError: There are none.
    """
    check_file(path, _LARGEST_LIST)
    text = read_text(path, _LARGEST_LIST, ExchangeError, "name a list of names")
    lines = (line.strip() for line in text.splitlines())
    names = tuple(line.rstrip(",;") for line in lines if line and not line.startswith(MARKS))
    check_text(path, "the list", len(names), max(map(len, names), default=0))
    if not names:
        raise ExchangeError(f"{path}: an empty list; write one name per line")
    return names

"""Read an `.npz` file: sizes and types are checked before anything is unpacked.

Nothing in it is ever unpickled, and no array that is not known by name is read.
"""

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from orbitfb.core.errors import RecordError
from orbitfb.records.reading.raw import MOST_ARRAYS, Raw, check_kind, sort_arrays

_METHODS = {zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED}
_ABSURD_SIZE = 64 * 2**20
_ABSURD_RATIO = 200
_LONGEST_HEADER = 10_000
_DAMAGED = (
    OSError, EOFError, ValueError, TypeError, KeyError, SyntaxError, RecursionError,
    OverflowError, NotImplementedError, RuntimeError, struct.error, zlib.error,
    zipfile.BadZipFile, tokenize.TokenError,
)  # fmt: skip
"""All that zipfile and numpy raise over a damaged file."""


def read_npz(path: Path, largest: int) -> Raw:
    """Read the arrays of an `.npz` file.

    Args:
        path: The file.
        largest: Most that may be unpacked [bytes].

    Raises:
        RecordError: It is damaged, too large when unpacked, or holds what is no number or text.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = _members(path, archive, largest)
            arrays: dict[str, NDArray[Any]] = {}
            for name, member in members.items():
                with archive.open(member) as file:
                    array = _read(path, name, member.file_size, file)
                if array is not None:
                    arrays[name] = array
    except _DAMAGED as error:
        raise RecordError(
            f"{path}: damaged or truncated, no .npz file as numpy.savez writes it "
            f"({error or type(error).__name__}); copy it again from where it was made"
        ) from error
    except MemoryError as error:
        raise RecordError(
            f"{path}: its arrays do not fit into the memory; cut the record into pieces"
        ) from error
    return sort_arrays(path, arrays)


def _members(path: Path, archive: zipfile.ZipFile, largest: int) -> dict[str, zipfile.ZipInfo]:
    """Give the arrays to read by name; the directory of the zip file tells their sizes."""
    entries = archive.infolist()
    if len(entries) > MOST_ARRAYS:
        raise RecordError(
            f"{path}: {len(entries)} arrays, at most {MOST_ARRAYS} are read; leave out what is no "
            "part of the record"
        )
    unpacked = sum(entry.file_size for entry in entries)
    packed = sum(entry.compress_size for entry in entries)
    if unpacked > largest:
        biggest = max(entries, key=lambda entry: entry.file_size)
        raise RecordError(
            f"{path}: unpacks to {unpacked} bytes ('{_stem(biggest)}' alone to "
            f"{biggest.file_size}), {largest} are allowed; cut the record into pieces"
        )
    size = path.stat().st_size
    if packed > size or (unpacked > _ABSURD_SIZE and unpacked > _ABSURD_RATIO * size):
        raise RecordError(
            f"{path}: {size} bytes claim to unpack to {unpacked}, which no measured record does "
            "(a zip bomb?); nothing was unpacked; save the record again from where it was made"
        )
    members: dict[str, zipfile.ZipInfo] = {}
    for entry in entries:
        name = _stem(entry)
        if name in members:
            raise RecordError(f"{path}: array '{name}' is there twice; leave one out")
        if entry.flag_bits & 1:
            raise RecordError(f"{path}: array '{name}' is encrypted; save the record in the open")
        if entry.compress_type not in _METHODS:
            raise RecordError(
                f"{path}: array '{name}' is packed by method {entry.compress_type}; use "
                "numpy.savez or numpy.savez_compressed"
            )
        if entry.filename.endswith(".npy"):
            members[name] = entry
    return members


def _stem(entry: zipfile.ZipInfo) -> str:
    return entry.filename.removesuffix(".npy")


def _read(path: Path, name: str, size: int, file: IO[bytes]) -> NDArray[Any] | None:
    version = npy.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise RecordError(
            f"{path}: array '{name}' has a header of version {version}; save plain arrays"
        )
    read_header = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    shape, fortran, dtype = read_header(file, max_header_size=_LONGEST_HEADER)
    if not check_kind(path, name, dtype, shape):
        return None
    count = 1
    for length in shape:
        count *= length  # Python's integers do not overflow
    content = size - file.tell()
    if count < 0 or count * dtype.itemsize != content:
        raise RecordError(
            f"{path}: array '{name}' claims shape {shape} of {dtype}, which is "
            f"{count * dtype.itemsize} bytes, but holds {content}; it is truncated or forged: "
            "save it again"
        )
    flat = np.frombuffer(file.read(content), dtype=dtype)
    if len(flat) != count:
        raise EOFError(f"array '{name}' ends after {len(flat)} of {count} elements")
    return flat.reshape(shape, order="F" if fortran else "C")

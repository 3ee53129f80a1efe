"""Read the exchange format's arrays from the root of an HDF5 file."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RecordError
from orbitfb.records.gaps import is_gap
from orbitfb.records.reading.raw import (
    LONGEST_NAME,
    LONGEST_TEXT,
    MOST_ARRAYS,
    MOST_DEVICES,
    NUMBERS,
    TEXTS,
    Raw,
    canonical,
    check_kind,
    sort_arrays,
)

_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
_LARGEST_CHUNK = 2**28


def is_segment(path: Path) -> bool:
    """Tell whether an HDF5 file is a segment of the service's archive.

    Raises:
        RecordError: It is no HDF5 file, or damaged.
    """
    try:
        with h5py.File(path, "r") as file:
            return "schema_version" in file.attrs and "channels" in file
    except (OSError, RuntimeError, KeyError, ValueError) as error:
        raise _damaged(path, error) from error


def read_hdf5(path: Path, largest: int) -> Raw:
    """Read the arrays in the root of an HDF5 file.

    Args:
        path: The file.
        largest: Most that may be read [bytes].

    Raises:
        RecordError: It is damaged, too large, or holds what is no number or text.
    """
    try:
        with h5py.File(path, "r") as file:
            found = _datasets(path, file)
            if not found and len(file):
                raise RecordError(
                    f"{path}: holds only groups ({', '.join(list(file)[:5])}); put "
                    "the arrays of the record into the root of the file"
                )
            size = sum(int(np.prod(d.shape, dtype=object)) * d.dtype.itemsize for d in found)
            if size > largest:
                raise RecordError(
                    f"{path}: its arrays take {size} bytes, {largest} are allowed; cut the record "
                    "into pieces"
                )
            arrays = {str(d.name).strip("/"): _read(path, d) for d in found}
            arrays = {name: array for name, array in arrays.items() if array is not None}
            units = {canonical(str(d.name).strip("/")): _unit(d) for d in found}
            if "meta" not in arrays and isinstance(text := file.attrs.get("meta"), str):
                arrays["meta"] = np.array(text[:LONGEST_TEXT])
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise _damaged(path, error) from error
    except MemoryError as error:
        raise RecordError(
            f"{path}: its arrays do not fit into the memory; cut the record into pieces"
        ) from error
    told = {name: unit for name, unit in units.items() if name in NUMBERS or is_gap(name)}
    stated = {name: unit for name, unit in told.items() if unit}
    return replace(sort_arrays(path, arrays), units=stated)


def _unit(dataset: h5py.Dataset) -> str:
    unit = dataset.attrs.get("units", dataset.attrs.get("unit", ""))
    text = unit.decode(errors="replace") if isinstance(unit, bytes) else unit
    return text.strip() if isinstance(text, str) else ""


def _datasets(path: Path, file: h5py.File) -> list[h5py.Dataset]:
    if len(file) > MOST_ARRAYS:
        raise RecordError(
            f"{path}: {len(file)} arrays, at most {MOST_ARRAYS} are read; leave out what is no "
            "part of the record"
        )
    found: list[h5py.Dataset] = []
    for name in file:
        link = file.get(name, getlink=True)
        if not isinstance(link, h5py.HardLink):
            raise RecordError(
                f"{path}: array '{name}' is a link to somewhere else; put the data itself there"
            )
        dataset = file[name]
        if not isinstance(dataset, h5py.Dataset):
            continue
        if dataset.is_virtual or dataset.external:
            raise RecordError(f"{path}: array '{name}' lies in another file; put the data itself")
        made = dataset.id.get_create_plist()
        filters = {made.get_filter(i)[0] for i in range(made.get_nfilters())}
        if not filters <= _FILTERS:
            raise RecordError(f"{path}: array '{name}' is packed by an unknown filter; use gzip")
        if dataset.chunks is not None:
            chunk = int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize
            if chunk > _LARGEST_CHUNK:
                raise RecordError(
                    f"{path}: array '{name}' has chunks of {chunk} bytes; save it in chunks of "
                    "some MiB"
                )
        found.append(dataset)
    return found


def _read(path: Path, dataset: h5py.Dataset) -> NDArray[Any] | None:
    name = str(dataset.name).strip("/")
    if h5py.check_string_dtype(dataset.dtype) is None or dataset.dtype.kind == "S":
        wanted = check_kind(path, name, dataset.dtype, dataset.shape)
        return np.asarray(dataset[()]) if wanted else None
    if canonical(name) not in (*TEXTS, *NUMBERS):
        return None
    most = 1 if name == "meta" else MOST_DEVICES
    if canonical(name) not in TEXTS or dataset.ndim > 1 or (dataset.size or 0) > most:
        raise RecordError(
            f"{path}: array '{name}' holds text of shape {dataset.shape}, numbers were expected; "
            "save real numbers (float64)"
        )
    longest = LONGEST_TEXT if canonical(name) == "meta" else LONGEST_NAME
    places: list[Any] = [()] if dataset.ndim == 0 else list(range(dataset.shape[0]))
    items: list[bytes] = []
    for place in places:  # one by one: many rows may point to one long text
        item = dataset[place]
        item = item.encode() if isinstance(item, str) else bytes(item)
        if len(item) > longest:
            raise RecordError(
                f"{path}: array '{name}', row {place or 0}: a text of {len(item)} characters; at "
                f"most {longest} are read"
            )
        items.append(item)
    return np.array(items, dtype=np.bytes_)


def _damaged(path: Path, error: Exception) -> RecordError:
    return RecordError(
        f"{path}: damaged or truncated, no readable HDF5 file ({error}); copy it again from where "
        "it was made"
    )

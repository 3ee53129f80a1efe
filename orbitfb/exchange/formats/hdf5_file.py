"""Read arrays and names from HDF5, MATLAB's `.mat` of version 7.3 included.

MATLAB stores arrays with the first index running fastest; HDF5 tells them with the last one so.
What carries MATLAB's mark (the attribute `MATLAB_class`) is therefore turned round here; what any
other program wrote is taken as it stands.
"""

from pathlib import Path
from typing import Any

import h5py
import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector
from orbitfb.exchange.formats.datasets import (
    LONGEST_NAME,
    UNITS_BESIDE,
    Found,
    Step,
    absent,
    check_size,
    check_text,
    offset,
    steps_of,
)

_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}
_LARGEST_CHUNK = 2**28
_MOST_LISTED = 500
_DEEPEST = 4
_DAMAGE = (OSError, RuntimeError, KeyError, ValueError, TypeError, UnicodeError, MemoryError)
"""All that h5py raises over a damaged file."""


class Hdf5Source:
    """An HDF5 file.

    Args:
        path: The file.

    Raises:
        ExchangeError: It is none, or damaged.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with h5py.File(path, "r"):
                pass
        except _DAMAGE as error:
            raise self._damaged(error) from error

    @property
    def path(self) -> Path:
        """The file."""
        return self._path

    def listing(self) -> tuple[str, ...]:
        """Name the datasets, groups entered to some depth."""
        names: list[str] = []
        try:
            with h5py.File(self._path, "r") as file:
                self._walk(file, "", names, _DEEPEST)
        except _DAMAGE as error:
            raise self._damaged(error) from error
        return tuple(names)

    def get(self, where: str) -> Found:
        """Read what lies under a path; `units` is its attribute, or the text beside it."""
        try:
            with h5py.File(self._path, "r") as file:
                dataset = self._dataset(file, where)
                numbers, texts = self._content(file, dataset, where)
                return Found(where, numbers, texts, self._units(file, dataset, where))
        except _DAMAGE as error:
            raise self._damaged(error) from error

    def _walk(self, group: h5py.Group, prefix: str, names: list[str], depth: int) -> None:
        for name in group:
            if len(names) >= _MOST_LISTED or str(name).startswith("#"):  # '#refs#': inside of cells
                continue
            if not isinstance(group.get(name, getlink=True), h5py.HardLink):
                continue
            child = group[name]
            if isinstance(child, h5py.Dataset):
                names.append(f"{prefix}{name}")
            elif isinstance(child, h5py.Group) and depth:
                self._walk(child, f"{prefix}{name}.", names, depth - 1)

    def _dataset(self, file: h5py.File, where: str) -> h5py.Dataset:
        whole = [Step(part, ()) for part in where.strip("/").split("/")]
        found = self._follow(file, whole, where) or self._follow(file, steps_of(where), where)
        if isinstance(found, h5py.Group):
            raise ExchangeError(
                f"{self._path}: {where} is a group of {', '.join(list(found)[:10]) or 'nothing'}; "
                "name one of them, with a dot between"
            )
        if found is None:
            raise absent(self, where)
        return self._checked(found, where)

    def _follow(self, file: h5py.File, steps: list[Step], where: str) -> Any:
        """Follow a path; None when it leads nowhere."""
        here: Any = file
        pending: tuple[int, ...] = ()
        for step in steps:
            if not isinstance(here, h5py.Group) or step.name not in here:
                return None
            if not isinstance(here.get(step.name, getlink=True), h5py.HardLink):
                raise ExchangeError(
                    f"{self._path}: {where} is a link to somewhere else; put the data itself there"
                )
            here = here[step.name]
            index = step.index or pending
            pending = ()
            if isinstance(here, h5py.Group):
                pending = index  # of a struct array: its fields hold the elements
            elif _refers(here) and (index or step is not steps[-1]):
                shape = here.shape[::-1]
                here = file[here[offset(shape, index, where)[::-1]]]
            elif index and tuple(index) != (1,) * len(index):
                raise ExchangeError(f"{self._path}: {where} is no array of structs or cells")
        return here

    def _checked(self, dataset: h5py.Dataset, where: str) -> h5py.Dataset:
        if dataset.is_virtual or dataset.external:
            raise ExchangeError(f"{self._path}: {where} lies in another file; put the data itself")
        made = dataset.id.get_create_plist()
        filters = {made.get_filter(i)[0] for i in range(made.get_nfilters())}
        if not filters <= _FILTERS:
            raise ExchangeError(f"{self._path}: {where} is packed by an unknown filter; use gzip")
        check_size(self._path, where, dataset.shape or (), dataset.dtype.itemsize)
        if dataset.chunks is not None:
            chunk = int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize
            if chunk > _LARGEST_CHUNK:
                raise ExchangeError(f"{self._path}: {where} has chunks of {chunk} bytes")
        return dataset

    def _content(
        self, file: h5py.File, dataset: h5py.Dataset, where: str
    ) -> tuple[Vector, tuple[str, ...]]:
        matlab = dataset.attrs.get("MATLAB_class", b"")
        matlab = matlab.decode("ascii", "replace") if isinstance(matlab, bytes) else str(matlab)
        if "MATLAB_empty" in dataset.attrs or dataset.shape is None:
            return np.empty((0, 0)), ()
        if matlab == "char":
            return np.empty(0), self._characters(dataset, where)
        if _refers(dataset):
            check_text(self._path, where, int(dataset.size or 0), 0)
            cells = (file[each] for each in np.asarray(dataset[()]).reshape(-1))
            texts: list[str] = []
            for cell in cells:
                if not isinstance(cell, h5py.Dataset) or cell.dtype.kind not in "u":
                    raise ExchangeError(f"{self._path}: {where} holds cells that are no text")
                texts += self._characters(self._checked(cell, where), where) or ("",)
            return np.empty(0), tuple(texts)
        if dataset.dtype.kind == "S" or h5py.check_string_dtype(dataset.dtype) is not None:
            return np.empty(0), self._strings(dataset, where)
        if dataset.dtype.kind not in "fiub":
            raise ExchangeError(
                f"{self._path}: {where} has type {dataset.dtype}; real numbers or names are needed"
            )
        numbers = np.asarray(dataset[()], dtype=np.float64)
        return (numbers.T if matlab else numbers), ()

    def _units(self, file: h5py.File, dataset: h5py.Dataset, where: str) -> str:
        units = dataset.attrs.get("units", "")
        beside = dataset.parent
        group = beside if isinstance(beside, h5py.Group) and beside.name != "/" else None
        for name in UNITS_BESIDE:
            there = group[name] if group is not None and name in group else None
            if not units and isinstance(there, h5py.Dataset) and there is not dataset:
                texts = self._content(file, self._checked(there, where), where)[1]
                units = texts[0] if texts else ""
        units = units.decode("utf-8", "replace") if isinstance(units, bytes) else units
        return units if isinstance(units, str) else ""

    def _characters(self, dataset: h5py.Dataset, where: str) -> tuple[str, ...]:
        """Give the rows of a MATLAB char array, stored as UTF-16 units, turned round."""
        if "MATLAB_empty" in dataset.attrs or dataset.ndim != 2:
            return ()
        check_text(self._path, where, dataset.shape[1], dataset.shape[0])
        rows = np.asarray(dataset[()], dtype="<u2").T
        return tuple(row.tobytes().decode("utf-16-le", "replace").rstrip() for row in rows)

    def _strings(self, dataset: h5py.Dataset, where: str) -> tuple[str, ...]:
        check_text(self._path, where, int(dataset.size or 0), 0)
        if dataset.ndim > 1:
            raise ExchangeError(f"{self._path}: {where} holds a table of texts; give one list")
        places: list[Any] = [()] if dataset.ndim == 0 else list(range(dataset.shape[0]))
        texts: list[str] = []
        for place in places:  # one by one: many rows may point to one long text
            item = dataset[place]
            text = item.decode("utf-8") if isinstance(item, bytes) else str(item)
            check_text(self._path, where, len(places), len(text))
            texts.append(text[:LONGEST_NAME])
        return tuple(texts)

    def _damaged(self, error: BaseException) -> ExchangeError:
        return ExchangeError(
            f"{self._path}: no readable HDF5 file ({str(error)[:200]}); copy it again from where "
            "it was made"
        )


def _refers(dataset: h5py.Dataset) -> bool:
    """Tell whether a dataset holds references to objects, as MATLAB's cells do."""
    return h5py.check_ref_dtype(dataset.dtype) is h5py.Reference

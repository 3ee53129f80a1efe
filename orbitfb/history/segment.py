"""One segment of the archive: an HDF5 file that is valid from its first to its last moment.

HDF5 keeps its bookkeeping in memory and on disk at once, so a file that grows is broken
whenever its writer dies between two writes. A segment does not grow: it is made whole, with
room for all of its rows in contiguous datasets, closed, and only then given its name. From
there on rows go straight into the datasets' bytes, as `Dataset.id.get_offset` says where they
are, and HDF5's own structures are never touched again. A row counts when its byte in `whole`
is 1, and that is written after everything else is on disk. So a kill at any moment leaves a
file that any HDF5 program opens, with every row that was marked.

A full segment is rewritten once, compressed, under the same name.

HDF5 itself never meets a disk that refuses: see `Sink`.
"""

import os
import uuid
import zlib
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import COUNTS, Channels
from orbitfb.history.columns import AUXILIARY, STATES, UNITS, Columns, Layout
from orbitfb.history.sink import Sink, write_all

SCHEMA_VERSION = 1
"""Version of the segments; another one is refused."""

MARK = "whole"
"""The dataset that says which rows are complete."""

CHANNELS = "channels/"
"""What the names of the datasets begin with that hold the names of the channels."""

UNFINISHED = ".unfinished-"
"""What the names of files begin with that are not yet, or never became, a segment."""

_CHUNK_BYTES = 2**18
_LEVEL = 1
_FORMAT = ("v110", "v110")  # the oldest format whose bookkeeping carries checksums throughout


class RawSegment:
    """A segment that is being filled.

    Args:
        path: Its name; there must be no such file.
        channels: The names behind the vectors.
        plan: The columns of one row.
        rows: How many rows it has room for.
        run: Name of the writer's run; ticks of different runs are not related.

    Raises:
        OSError: It cannot be made; nothing is left behind.
    """

    def __init__(self, path: Path, channels: Channels, plan: Layout, rows: int, run: str) -> None:
        self.path = path
        self.plan = plan
        self.rows = rows
        self.used = 0
        unfinished = path.parent / f"{UNFINISHED}{uuid.uuid4().hex}"
        try:
            sink = Sink(unfinished)
            self._descriptor = sink.descriptor
            try:
                self._offsets = _create(sink, channels, plan, rows, run)
                sink.check()
                os.fsync(self._descriptor)
                unfinished.rename(path)
            except BaseException:
                self.close()
                raise
        finally:
            unfinished.unlink(missing_ok=True)

    def append(self, columns: Columns, start: int, stop: int) -> None:
        """Write rows, then mark them.

        Args:
            columns: Columns as planned.
            start: First row of them to write.
            stop: Row after the last; it must fit, see `rows` and `used`.

        Raises:
            OSError: They are not, or not all, on disk; none of them is marked.
        """
        if os.fstat(self._descriptor).st_nlink == 0:
            raise FileNotFoundError(2, "the segment was removed", str(self.path))
        for name in self.plan:
            self._write(name, np.ascontiguousarray(columns[name][start:stop]))
        os.fdatasync(self._descriptor)
        self._write(MARK, np.ones(stop - start, dtype=np.uint8))
        self.used += stop - start

    def close(self) -> None:
        """Let go of the file."""
        os.close(self._descriptor)

    def _write(self, name: str, values: NDArray[Any]) -> None:
        row_size = values.nbytes // len(values)
        position = self._offsets[name] + self.used * row_size
        write_all(self._descriptor, memoryview(values.tobytes()), position)


def compressing(path: Path) -> Generator[None]:
    """Rewrite a segment compressed, without the room that it did not use, in small steps.

    Whoever runs the steps can do something else in between. A segment without rows goes away,
    one that is compressed stays as it is.

    Yields:
        After each step of some milliseconds.

    Raises:
        OSError: It cannot be read or written; the segment stays as it is.
    """
    unfinished = path.parent / f"{UNFINISHED}{uuid.uuid4().hex}"
    try:
        with h5py.File(path, "r") as source:
            if source.attrs.get("compressed", True):
                return
            datasets: dict[str, h5py.Dataset] = {}
            source.visititems(
                lambda name, found: (
                    datasets.update({name: found}) if isinstance(found, h5py.Dataset) else None
                )
            )
            rows = count_rows(datasets[MARK][:])
            if rows == 0:
                path.unlink()
                return
            sink = Sink(unfinished)
            try:
                with h5py.File(sink, "w", libver=_FORMAT) as target:
                    for name, value in source.attrs.items():
                        target.attrs[name] = value
                    target.attrs["compressed"] = True
                    target.create_group(AUXILIARY[:-1])
                    for name, dataset in datasets.items():
                        if name.startswith(CHANNELS):
                            target[name] = dataset[:]
                            continue
                        for _ in _compress_dataset(dataset, target, name, rows):
                            sink.check()
                            yield
                sink.check()
                os.fsync(sink.descriptor)
            finally:
                sink.close_descriptor()
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)


def count_rows(marks: NDArray[np.uint8]) -> int:
    """Count the complete rows: those before the first that is not marked."""
    missing = np.flatnonzero(marks != 1)
    return int(missing[0]) if len(missing) else len(marks)


def unit_of(name: str) -> str:
    """Give the unit of a column."""
    return "SI" if name.startswith(AUXILIARY) else UNITS[name]


def _create(sink: Sink, channels: Channels, plan: Layout, rows: int, run: str) -> dict[str, int]:
    """Make the empty file and say where the rows of each dataset begin [bytes]."""
    properties = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    properties.set_layout(h5py.h5d.CONTIGUOUS)
    properties.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    # Never filled, the file is sparse, and what is sparse reads as 0: not marked.
    properties.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    with h5py.File(sink, "w", libver=_FORMAT) as file:
        file.attrs["schema_version"] = SCHEMA_VERSION
        file.attrs["planes"] = channels.planes
        for word in COUNTS:
            if counts := getattr(channels, word):
                file.attrs[word] = np.array(counts, dtype=np.int64)
        file.attrs["run"] = run
        file.attrs["compressed"] = False
        file[CHANNELS + "bpms"] = np.array([name.encode() for name in channels.bpms])
        file[CHANNELS + "correctors"] = np.array([name.encode() for name in channels.correctors])
        file.create_group(AUXILIARY[:-1])
        offsets: dict[str, int] = {}
        for name, (kind, shape) in {**plan, MARK: (np.dtype("u1"), ())}.items():
            stored = (
                h5py.enum_dtype({str(s): i for i, s in enumerate(STATES)}, "u1")
                if name == "state"
                else kind
            )
            identifier = h5py.h5d.create(
                file.id,
                name.encode(),
                h5py.h5t.py_create(stored, logical=True),
                h5py.h5s.create_simple((rows, *shape)),
                dcpl=properties,
            )
            if name != MARK:
                h5py.Dataset(identifier).attrs["units"] = unit_of(name)
            offsets[name] = identifier.get_offset()
    return offsets


def _compress_dataset(
    source: h5py.Dataset, target: h5py.File, name: str, rows: int
) -> Iterator[None]:
    """Copy the rows of a dataset, chunk by chunk, through shuffle and deflate.

    The filters are run here and not by HDF5, because zlib lets other threads run meanwhile and
    HDF5 does not: the loop must not wait for its archive.
    """
    row_size = source.dtype.itemsize * int(np.prod(source.shape[1:]))
    chunk = max(1, min(rows, _CHUNK_BYTES // row_size))
    made = target.create_dataset(
        name,
        shape=(rows, *source.shape[1:]),
        dtype=source.dtype,
        chunks=(chunk, *source.shape[1:]),
        shuffle=True,
        compression="gzip",
        compression_opts=_LEVEL,
    )
    for key, value in source.attrs.items():
        made.attrs[key] = value
    for start in range(0, rows, chunk):
        values = source[start : min(start + chunk, rows)]
        padded = np.zeros((chunk, *source.shape[1:]), source.dtype)
        padded[: len(values)] = values
        bytewise = padded.reshape(-1).view(np.uint8).reshape(-1, source.dtype.itemsize)
        shuffled = np.ascontiguousarray(bytewise.T)
        offset = (start,) + (0,) * (source.ndim - 1)
        made.id.write_direct_chunk(offset, zlib.compress(shuffled.tobytes(), _LEVEL))
        yield

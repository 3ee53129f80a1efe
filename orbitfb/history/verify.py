"""Read one segment, believing nothing that it says before it is checked."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from orbitfb.core.errors import ArchiveError
from orbitfb.core.signals import COUNTS, Channels
from orbitfb.history.columns import AUXILIARY, STATES, Columns, layout, row_bytes
from orbitfb.history.segment import CHANNELS, MARK, SCHEMA_VERSION, count_rows

_MOST_CHANNELS = 100_000
_MOST_AUXILIARY = 1_000
_MOST_ROWS = 20_000_000
_LONGEST_NAME = 256
_LARGEST_CHUNK = 2**26
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE}
_ADVICE = "move the file away, or skip what is corrupt"


class CorruptSegmentError(ArchiveError):
    """A file is no segment, or no longer one."""


@dataclass(frozen=True, slots=True)
class SegmentContent:
    """What was read from one segment.

    Args:
        path: The file.
        channels: Planes and names; it knows no PVs.
        run: The run of the writer that made it.
        columns: Its complete rows.
    """

    path: Path
    channels: Channels
    run: str
    columns: Columns

    @property
    def rows(self) -> int:
        """Number of complete rows."""
        return len(self.columns["tick"])

    @property
    def size(self) -> int:
        """Memory that the columns take [bytes]."""
        return sum(column.nbytes for column in self.columns.values())


def read_segment(path: Path, largest: int) -> SegmentContent:
    """Read the complete rows of a segment.

    Args:
        path: The file.
        largest: Most that may be read [bytes].

    Raises:
        CorruptSegmentError: It is no segment, is damaged, or of another version.
        ArchiveError: It is larger than that.
        FileNotFoundError: It is not there.
    """
    try:
        with h5py.File(path, "r") as file:
            return _read(file, path, largest)
    except FileNotFoundError:
        raise
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        # All that h5py raises over a damaged file.
        raise CorruptSegmentError(
            f"{path} cannot be read as a segment ({error}); {_ADVICE}"
        ) from error


def _read(file: h5py.File, path: Path, largest: int) -> SegmentContent:
    version = file.attrs.get("schema_version")
    if version is None:
        raise CorruptSegmentError(
            f"{path} is no segment of an archive of orbitfb: it has no schema_version; {_ADVICE}"
        )
    if version != SCHEMA_VERSION:
        raise CorruptSegmentError(
            f"{path} has schema_version {version}, this program reads {SCHEMA_VERSION}; use the "
            f"version of orbitfb that wrote it, or {_ADVICE}"
        )
    names = {word: _names(_dataset(file, CHANNELS + word, path)) for word in ("bpms", "correctors")}
    planes, run = file.attrs["planes"], file.attrs["run"]
    if not isinstance(planes, str) or not isinstance(run, str):
        raise ValueError("planes or run is no text")
    each = [_counts(file, word, len(its)) for word, its in zip(COUNTS, names.values(), strict=True)]
    channels = Channels(planes, names["bpms"], names["correctors"], (), (), (), each[0], each[1])
    slow = file[AUXILIARY[:-1]]
    if not isinstance(slow, h5py.Group) or len(slow) > _MOST_AUXILIARY:
        raise ValueError(f"'{slow.name}' is no group of slow channels")
    auxiliary = [str(name) for name in slow]
    plan = layout(channels, auxiliary)
    mark = _dataset(file, MARK, path)
    room = mark.shape[0] if mark.ndim == 1 else -1
    if not 0 <= room <= _MOST_ROWS or mark.dtype != np.uint8:
        raise ValueError(f"'{MARK}' has shape {mark.shape} and type {mark.dtype}")
    columns: dict[str, h5py.Dataset] = {}
    for name, (kind, shape) in plan.items():
        column = _dataset(file, name, path)
        if column.shape != (room, *shape) or column.dtype != kind:
            raise ValueError(
                f"'{name}' has shape {column.shape} and type {column.dtype}, expected were "
                f"{(room, *shape)} and {kind}"
            )
        columns[name] = column
    rows = count_rows(mark[:])
    if rows * row_bytes(plan) > largest:
        raise ArchiveError(
            f"{path} and what was read before it take more than the {largest} bytes allowed; read "
            "a single segment or only the last transitions"
        )
    read: Columns = {name: column[:rows] for name, column in columns.items()}
    read["state"] = read["state"].astype(np.uint8)
    if rows and read["state"].max() >= len(STATES):
        raise ValueError(f"'state' holds {read['state'].max()}, which is no state")
    return SegmentContent(path, channels, run, read)


def _dataset(file: h5py.File, name: str, path: Path) -> h5py.Dataset:
    """Give a dataset that lies in this very file, in pieces of a sane size."""
    link = file.get(name, getlink=True)
    dataset = file.get(name) if isinstance(link, h5py.HardLink) else None
    if not isinstance(dataset, h5py.Dataset):
        raise CorruptSegmentError(f"{path} has no dataset '{name}'; {_ADVICE}")
    if dataset.is_virtual or dataset.external:
        raise CorruptSegmentError(f"'{name}' of {path} lies in another file; {_ADVICE}")
    made = dataset.id.get_create_plist()
    filters = {made.get_filter(i)[0] for i in range(made.get_nfilters())}
    if not filters <= _FILTERS:
        raise CorruptSegmentError(f"'{name}' of {path} is packed by an unknown filter; {_ADVICE}")
    if dataset.chunks is not None:
        size = int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize
        if size > _LARGEST_CHUNK:
            raise CorruptSegmentError(f"'{name}' of {path} has chunks of {size} bytes; {_ADVICE}")
    return dataset


def _counts(file: h5py.File, word: str, size: int) -> tuple[int, ...]:
    """Read how many devices each plane has; empty: as many in each."""
    if word not in file.attrs:
        return ()
    counts = np.asarray(file.attrs[word])
    if counts.shape != (len(str(file.attrs["planes"])),) or counts.dtype != np.int64:
        raise ValueError(f"{word} has shape {counts.shape} and type {counts.dtype}")
    if not (counts > 0).all() or counts.sum() != size:
        raise ValueError(f"{word} holds {counts.tolist()} for {size} devices")
    return tuple(counts.tolist())


def _names(dataset: h5py.Dataset) -> tuple[str, ...]:
    if (
        dataset.ndim != 1
        or not 0 < dataset.shape[0] <= _MOST_CHANNELS
        or dataset.dtype.kind != "S"
        or dataset.dtype.itemsize > _LONGEST_NAME
    ):
        raise ValueError(f"'{dataset.name}' has shape {dataset.shape} and type {dataset.dtype}")
    return tuple(name.decode() for name in dataset[:])

"""Read any record of operation: the service's archive, an `.npz` file, an HDF5 file.

A record is believed only after it has been checked, and nothing in it is ever executed.
"""

import math
import stat
from pathlib import Path

from orbitfb.core.errors import RecordError
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Planes, Ring
from orbitfb.records.reading.assemble import Loaded, from_archive, from_arrays
from orbitfb.records.reading.hdf5 import is_segment, read_hdf5
from orbitfb.records.reading.npz import read_npz
from orbitfb.records.reading.raw import LARGEST_RECORD
from orbitfb.records.record import Record

_HDF5 = (".h5", ".hdf5", ".hdf")


def load_record(
    path: Path,
    *,
    planes: Planes | None = None,
    ring: Ring | None = None,
    response: Matrix | None = None,
    period: float | None = None,
) -> Record:
    """Read a record; as `load`, without the findings."""
    return load(path, planes=planes, ring=ring, response=response, period=period).record


def load(
    path: Path,
    *,
    planes: Planes | None = None,
    ring: Ring | None = None,
    response: Matrix | None = None,
    period: float | None = None,
    largest: int = LARGEST_RECORD,
) -> Loaded:
    """Read a record, whatever it is in.

    Args:
        path: A segment of the archive or a directory of them, an `.npz` or an HDF5 file.
        planes: Plane(s) to look at; all that the record has when None.
        ring: Whose names the devices may have; the default ring when None.
        response: Model to question, shape (n, m) of the record [m/A]; by default the record's
            own, or that of the ring's optics.
        period: From one orbit to the next [s]; by default the record's.
        largest: Most that may be read into memory [bytes].

    Raises:
        RecordError: It cannot be read, or an array is wrong; the message names file, array and
            row, and says what to do.
    """
    path = Path(path)
    known = ring or Ring.load()
    if period is not None and not 0 < period < math.inf:
        raise RecordError(f"the period is {period}; give the seconds between two orbits, above 0")
    if _is_archive(path):
        return from_archive(path, planes, known, response, period, largest)
    raw = read_npz(path, largest) if path.suffix.lower() == ".npz" else read_hdf5(path, largest)
    return from_arrays(raw, planes, known, response, period)


def _is_archive(path: Path) -> bool:
    """Look at what there is under a path, opening nothing but plain files."""
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise RecordError(f"{path}: cannot be read ({reason}); correct the path") from error
    if stat.S_ISDIR(mode):
        if not any(path.glob("*.h5")):
            raise RecordError(
                f"{path}: a directory without segments (*.h5) of an archive; name the archive's "
                "directory, or a file"
            )
        return True
    if not stat.S_ISREG(mode):
        raise RecordError(f"{path}: no plain file; name an .npz or HDF5 file, or an archive")
    suffix = path.suffix.lower()
    if suffix not in (".npz", *_HDF5):
        raise RecordError(
            f"{path}: records end in .npz, {', '.join(_HDF5)}, not in {suffix or 'nothing'!r}; "
            "save the arrays by numpy.savez_compressed, or rename the file"
        )
    if path.stat().st_size == 0:
        raise RecordError(f"{path}: an empty file; copy the record again from where it was made")
    return suffix != ".npz" and is_segment(path)

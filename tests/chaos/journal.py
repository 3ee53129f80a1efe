"""What the soft IOC writes down at every tick, by records of one size that survive a kill -9."""

import os
from pathlib import Path

import numpy as np

RECORD = np.dtype(
    [
        ("wall", "f8"),  # s since the epoch
        ("tick", "i8"),
        ("life", "i4"),  # which start of the IOC
        ("good", "i8"),  # tick of the last orbit that may be acted on
        ("puts", "i4"),  # setpoints put since the record before
        ("excess", "i4"),  # puts to one setpoint beyond orbits to act on, while there was none
        ("nonfinite", "i4"),  # puts that are not finite
        ("beyond", "i4"),  # puts beyond the limit of a setpoint
        ("steps", "i4"),  # puts further from the setpoint in force than a step may be
        ("refused", "i4"),  # puts beyond the drive limit of this IOC
        ("largest", "f4"),  # |setpoint| put [A]
        ("step", "f4"),  # longest step [A]
        ("rms", "f4"),  # of the true orbit [m]
        ("peak", "f4"),  # of it [m]
        ("faults", "i4"),  # how many are on
    ]
)


class Journal:
    """Appends records.

    Args:
        path: File.
    """

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC, 0o600)

    def write(self, **values: float) -> None:
        """Append one."""
        record = np.zeros(1, dtype=RECORD)
        for name, value in values.items():
            record[name] = value
        os.write(self._file, record.tobytes())


def read(path: Path) -> np.ndarray:
    """Read all whole records."""
    data = path.read_bytes()
    return np.frombuffer(data, dtype=RECORD, count=len(data) // RECORD.itemsize)

"""Write a record in the exchange format: an `.npz` file with one row per transition."""

import json
from pathlib import Path

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.records.record import Record

_MM = 1e3
_NAMES_OF_CHANNELS = {"current": "current", "rf_frequency": "rf"}


def save_npz(record: Record, path: Path) -> None:
    """Write a record as `.npz`: mm and A, every transition with its next orbit.

    Args:
        record: The record.
        path: File to write.

    Raises:
        OSError: It cannot be written.
    """
    arrays = exchange_arrays(record)
    with path.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def exchange_arrays(record: Record) -> dict[str, Vector]:
    """Give the arrays of the exchange format by name."""
    last = np.roll(record.starts, -1)
    last[-1] = True
    first = np.flatnonzero(~last)
    layout = record.layout
    arrays = {
        "t": record.time[first],
        "orbit": record.readings[first] * _MM,
        "action": record.requested[first],
        "setpoint": record.setpoints[first],
        "next_orbit": record.readings[first + 1] * _MM,
        "model_R": layout.response * _MM,
        "bpm_names": np.array(layout.bpms.names),
        "corr_names": np.array(layout.correctors.names),
        "meta": np.array(
            json.dumps(
                {
                    "dt_s": layout.period,
                    "units": {"orbit": "mm", "action": "A", "model_R": "mm/A", "t": "s"},
                    "bpm_planes": "".join(layout.bpms.planes),
                    "corr_planes": "".join(layout.correctors.planes),
                    "source": record.source,
                }
            )
        ),
    }
    if record.readback is not None:
        arrays["readback"] = record.readback[first]
    if record.dither is not None:
        arrays["dither"] = record.dither[first]
    if record.reference is not None:
        arrays["reference"] = record.reference[first] * _MM
    for channel, name in _NAMES_OF_CHANNELS.items():
        if channel in record.auxiliary:
            arrays[name] = record.auxiliary[channel][first]
    return arrays

"""An orbit history from elsewhere, checked and written as the record that `diagnose` takes."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.exchange.naming import plain_labels
from orbitfb.exchange.orbits.align import MOST
from orbitfb.exchange.plausible import history_problem
from orbitfb.exchange.writing import write_whole
from orbitfb.physics.places import Ring, split
from orbitfb.physics.response import response

MOST_INVALID = 0.05
"""Share of the ticks at which a BPM may be invalid; with more it is left out [1]."""

FEWEST = 30
"""Fewest transitions of which a record is made."""

_APART = 0.2
"""How far from the period the time between two ticks may be for them to follow, relative [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """Ticks of a machine, as far as they are known.

    Args:
        time: Rising, shape (T,) [s since the epoch].
        orbit: Shape (T, n) of the ring [m]; NaN where not valid.
        setpoints: In force when the orbit was read, shape (T, m) [A]; NaN where not known.
        readback: Shape (T, m) [A], or None.
        auxiliary: Slow channels by name, each (T,), SI.
    """

    time: Vector
    orbit: Vector
    setpoints: Vector
    readback: Vector | None
    auxiliary: Mapping[str, Vector]


def write_history(
    history: History, ring: Ring, channels: Channels, out: Path, period: float | None, anyway: bool
) -> dict[str, Any]:
    """Check a history, keep the transitions that are whole, and write them.

    A transition is two ticks one period apart at which most BPMs that are kept are valid and every
    corrector that is kept is known. Nothing is filled in: a BPM that is not valid has NaN.

    Args:
        history: What was read.
        ring: The ring.
        channels: Its names.
        out: The record, an HDF5 file.
        period: From one tick to the next [s]; None: the median.
        anyway: Write it although its sizes are not plausible.

    Returns:
        What was kept and what was left out.

    Raises:
        ExchangeError: It is not plausible, or too little of it is whole.
    """
    if out.suffix.lower() not in (".h5", ".hdf5"):
        raise ExchangeError(f"--out {out}: the record is an HDF5 file; let its name end in .h5")
    back = np.flatnonzero(~(np.diff(history.time) > 0))
    if len(back):
        raise ExchangeError(
            f"the time does not rise at row {int(back[0]) + 1} ({len(back)} such rows); put the "
            "rows in the order in which they were read, each once"
        )
    bpms, correctors = _kept(history)
    planes: Any = channels.planes
    nominal = response(ring, planes)
    calibration = np.concatenate([ring.calibration(plane) for plane in split(planes)])
    problem = history_problem(
        history.orbit[:, bpms],
        history.setpoints[:, correctors],
        nominal[np.ix_(bpms, correctors)],
        calibration[correctors],
    )
    if problem and not anyway:
        raise ExchangeError(f"the history is not taken: {problem}; --anyway takes it as it is")
    seconds = period or float(np.median(np.diff(history.time)))
    rows, gaps = _whole(history, bpms, correctors, seconds)
    if len(rows) < FEWEST:
        raise ExchangeError(
            f"{len(rows)} of {len(history.time) - 1} transitions are whole (most BPMs valid, all "
            f"correctors known, {seconds:.4g} s apart), {FEWEST} are needed; leave out BPMs or "
            "correctors that are mostly not there, give --period, or a larger --tolerance"
        )
    arrays = _arrays(history, rows, bpms, correctors)
    arrays["model_R"] = nominal[np.ix_(bpms, correctors)]
    names = {
        "bpm_names": np.array(plain_labels(channels.bpms, channels.bpm_planes))[bpms],
        "corr_names": np.array(plain_labels(channels.correctors, channels.corrector_planes))[
            correctors
        ],
    }
    write_whole(out, _hdf5(arrays, names, seconds))
    left = ~bpms & np.isfinite(history.orbit).any(axis=0)
    return {
        "file": str(out),
        "transitions": len(rows),
        "ticks": len(history.time),
        "gaps": gaps,
        "missing_readings": int(np.isnan(arrays["orbit"]).sum()),
        "period": seconds,
        "bpms": int(bpms.sum()),
        "correctors": int(correctors.sum()),
        "bpms_left_out": ", ".join(
            np.array(plain_labels(channels.bpms, channels.bpm_planes))[left]
        ),
        "implausible": problem,
    }


def _kept(history: History) -> tuple[Mask, Mask]:
    """Choose the BPMs that are mostly valid, the correctors that are ever known."""
    bpms: Mask = np.isnan(history.orbit).mean(axis=0) <= MOST_INVALID
    correctors: Mask = np.asarray(np.isfinite(history.setpoints).any(axis=0))
    known: Mask = np.asarray(np.isfinite(history.orbit).any(axis=0))
    if not bpms.any():
        most = f"{100 * MOST_INVALID:.0f} % of the time"
        raise ExchangeError(
            f"no BPM is valid often enough: {np.count_nonzero(known)} of {len(known)} have any "
            f"number, none is invalid at most {most}; see that the columns are named as the ring "
            "names them, and hold numbers"
        )
    if not correctors.any():
        raise ExchangeError(
            "no corrector has any number; give its setpoints too, in columns named as the ring "
            "names them"
        )
    return bpms, correctors


def _whole(history: History, bpms: Mask, correctors: Mask, period: float) -> tuple[Any, int]:
    """Find the ticks from which a whole transition begins, and count the gaps between them."""
    good: Mask = np.asarray(np.isfinite(history.orbit[:, bpms]).mean(axis=1) >= MOST)
    good &= np.isfinite(history.setpoints[:, correctors]).all(axis=1)
    follows = np.abs(np.diff(history.time) / period - 1.0) <= _APART
    rows = np.flatnonzero(good[:-1] & good[1:] & follows)
    return rows, int(np.count_nonzero(np.diff(rows) > 1)) if len(rows) else 0


def _arrays(history: History, rows: Any, bpms: Mask, correctors: Mask) -> dict[str, Vector]:
    orbit, setpoints = history.orbit[:, bpms], history.setpoints[:, correctors]
    arrays = {
        "t": history.time[rows],
        "orbit": orbit[rows],
        "next_orbit": orbit[rows + 1],
        "setpoint": setpoints[rows],
        "action": setpoints[rows + 1] - setpoints[rows],
    }
    if history.readback is not None:
        readback = history.readback[:, correctors][rows]
        if np.isfinite(readback).all():  # the record knows no holes
            arrays["readback"] = readback
    names = {"current": "current", "rf_frequency": "rf"}
    for name, column in history.auxiliary.items():
        if np.isfinite(column[rows]).all():
            arrays[names.get(name, name)] = column[rows]
    return arrays


def _hdf5(arrays: Mapping[str, Vector], names: Mapping[str, Any], period: float) -> bytes:
    """Make the file in memory, SI throughout, its units stated."""
    lengths = dict.fromkeys(("orbit", "next_orbit"), "m")
    currents = dict.fromkeys(("setpoint", "action", "readback", "current"), "A")
    units = {**lengths, **currents, "model_R": "m/A", "t": "s", "rf": "Hz"}
    meta = {"dt_s": period, "units": {name: units[name] for name in arrays if name in units}}
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, array in arrays.items():
            whole = array.ndim == 2
            file.create_dataset(
                name, data=array, compression="gzip" if whole else None, shuffle=whole or None
            )
            file[name].attrs["units"] = units.get(name, "1")
        for name, texts in names.items():
            file[name] = np.char.encode(texts, "utf-8")
        file["meta"] = json.dumps(meta)
    return content.getvalue()


def empty_history(time: Vector, channels: Channels) -> History:
    """Give a history of which nothing but the time is known."""
    orbit = np.full((len(time), len(channels.bpms)), np.nan)
    return History(time, orbit, np.full((len(time), len(channels.correctors)), np.nan), None, {})

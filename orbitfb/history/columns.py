"""The columns in which records of ticks are kept, in memory and on disk, and what they become.

One row is one tick, written once; a transition is made of two rows that follow each other
when somebody asks for it. Buffer and archive share this layout, so they cannot disagree.
"""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.names import FAST_FEEDBACK, RF_STEP
from orbitfb.core.signals import Channels, LoopState, TickRecord
from orbitfb.core.transitions import Transitions

Columns = dict[str, NDArray[Any]]
"""Arrays by name, each with one row per tick."""

Layout = dict[str, tuple[np.dtype[Any], tuple[int, ...]]]
"""Element type and shape of one row, by name."""

AUXILIARY = "auxiliary/"
"""What the names of slow channels begin with."""

STATES = tuple(LoopState)
"""The state behind each number in the column `state`."""

POLICY_BYTES = 128
"""Longest policy id that is kept [bytes]."""

_STATE_NUMBER = {state: number for number, state in enumerate(STATES)}

UNITS = {
    "tick": "1",
    "state": "1",
    "missed": "1",
    "time": "s",
    "written": "s",
    "latency": "s",
    "scale": "1",
    "policy_id": "",
    "orbit": "m",
    "valid": "1",
    "reference": "m",
    "setpoints": "A",
    "requested": "A",
    "dither": "A",
    "applied": "A",
    "readback": "A",
}
"""Unit of each column; those of slow channels are SI."""


def layout(channels: Channels, auxiliary: Iterable[str] = ()) -> Layout:
    """Describe one row for a ring of n BPMs and m correctors.

    Args:
        channels: The names behind the vectors.
        auxiliary: Names of slow channels.
    """
    n, m = (len(channels.bpms),), (len(channels.correctors),)
    real = np.dtype("<f8")
    plan: Layout = {
        "tick": (np.dtype("<i8"), ()),
        "state": (np.dtype("u1"), ()),
        "missed": (np.dtype("<i8"), ()),
        "time": (real, ()),
        "written": (real, ()),
        "latency": (real, ()),
        "scale": (real, ()),
        "policy_id": (np.dtype(f"S{POLICY_BYTES}"), ()),
        "orbit": (real, n),
        "valid": (np.dtype("?"), n),
        "reference": (real, n),
        "setpoints": (real, m),
        "requested": (real, m),
        "dither": (real, m),
        "applied": (real, m),
        "readback": (real, m),
    }
    return plan | {AUXILIARY + name: (real, ()) for name in auxiliary}


def row_bytes(plan: Layout) -> int:
    """Give the size of one row [bytes]."""
    return sum(kind.itemsize * int(np.prod(shape)) for kind, shape in plan.values())


def allocate(plan: Layout, rows: int) -> Columns:
    """Make columns of that many rows; their content is undefined."""
    return {name: np.empty((rows, *shape), kind) for name, (kind, shape) in plan.items()}


def fill(columns: Columns, row: int, record: TickRecord) -> None:
    """Write one record into one row. Slow channels without a column are left out."""
    reading = record.reading
    columns["tick"][row] = record.tick
    columns["state"][row] = _STATE_NUMBER[record.state]
    columns["missed"][row] = record.missed
    columns["written"][row] = record.written
    columns["latency"][row] = record.latency
    columns["scale"][row] = record.scale
    columns["policy_id"][row] = record.policy_id.encode()
    columns["reference"][row] = record.reference
    columns["setpoints"][row] = record.setpoints
    columns["requested"][row] = record.requested
    columns["dither"][row] = record.dither
    columns["applied"][row] = record.applied
    if reading is None:
        columns["time"][row] = np.nan
        columns["orbit"][row] = np.nan
        columns["valid"][row] = False
        columns["readback"][row] = np.nan
    else:
        columns["time"][row] = reading.orbit.time
        columns["orbit"][row] = reading.orbit.position
        columns["valid"][row] = reading.orbit.valid
        columns["readback"][row] = reading.readback
    known = {} if reading is None else reading.auxiliary
    for name, column in columns.items():
        if name.startswith(AUXILIARY):
            column[row] = known.get(name[len(AUXILIARY) :], np.nan)


def transitions_of(columns: Columns) -> Transitions:
    """Pair each row with the next one; the last row has none and gives no transition.

    A transition is usable if both ticks have a reading, follow each other with no orbit missed
    between, a_n had left before the stamp of s_{n+1} (or nothing was written), and no fast feedback
    was closed: what that does to the orbit is no answer to our changes. A step of the RF frequency
    is told at the orbit that answers it.

    Args:
        columns: One unbroken run of one loop, in order. The result may share its memory.
    """
    first, second = slice(None, -1), slice(1, None)
    tick, time, written = columns["tick"], columns["time"], columns["written"]
    followed = (np.diff(tick) == 1) & (columns["missed"][second] == 0)
    read = np.isfinite(time[first]) & np.isfinite(time[second])
    in_force = np.isnan(written[first]) | (written[first] <= time[second])
    steps = columns.get(AUXILIARY + RF_STEP)
    hertz = np.zeros(len(tick[first])) if steps is None else np.nan_to_num(steps[second])
    if (beside := columns.get(AUXILIARY + FAST_FEEDBACK)) is not None:
        in_force &= ~((beside[first] > 0.0) | (beside[second] > 0.0))
    auxiliary = {
        name[len(AUXILIARY) :]: column[first]
        for name, column in columns.items()
        if name.startswith(AUXILIARY)
    }
    return Transitions(
        tick=tick[first],
        time=time[first],
        next_time=time[second],
        written=written[first],
        orbit=columns["orbit"][first],
        next_orbit=columns["orbit"][second],
        reference=columns["reference"][first],
        valid=columns["valid"][first] & columns["valid"][second],
        requested=columns["requested"][first],
        applied=columns["applied"][first],
        dither=columns["dither"][first],
        setpoints=columns["setpoints"][first],
        readback=columns["readback"][first],
        policy_id=_decoded(columns["policy_id"][first]),
        closed=columns["state"][first] == _STATE_NUMBER[LoopState.CLOSED],
        hertz=hertz,
        usable=followed & read & in_force,
        auxiliary=auxiliary,
    )


def _decoded(names: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Decode ids once per stretch of equal ones: policies last for thousands of ticks."""
    if not len(names):
        return np.array([], dtype=np.str_)
    starts = np.concatenate([[0], np.flatnonzero(names[1:] != names[:-1]) + 1])
    lengths = np.diff(starts, append=len(names))
    return np.repeat(np.char.decode(names[starts], "utf-8", "replace"), lengths)

"""Read the service's archive for a diagnosis."""

from pathlib import Path

import numpy as np

from orbitfb.core.errors import ArchiveError, RecordError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.history.reader import read_archive, segment_paths
from orbitfb.history.verify import CorruptSegmentError, read_segment
from orbitfb.records.finding import Finding
from orbitfb.records.reading.stretches import FEWEST_ROWS, Transition

_ROUNDING = 1e-9
"""Difference of two changes of a setpoint that no limit made [A]."""


def read_transitions(path: Path, largest: int) -> tuple[Channels, Transition, list[Finding]]:
    """Read the transitions of a segment or of a directory of segments.

    Args:
        path: A segment or a directory.
        largest: Most that may be read [bytes].

    Returns:
        The channels, the usable transitions in SI, and what was skipped.

    Raises:
        RecordError: There is nothing readable, or too little of it.
    """
    corrupt: list[ArchiveError] = []
    try:
        channels = _channels(path, largest)
        read = read_archive(path, channels, on_corrupt=corrupt.append, largest=largest)
    except (ArchiveError, OSError) as error:
        raise RecordError(f"{path}: {error}") from error
    found = [Finding("archive-segment", "warning", (), None, str(each)) for each in corrupt]
    return channels, _transition(path, read, found), found


def _channels(path: Path, largest: int) -> Channels:
    """Give the names of the latest readable segment."""
    last: ArchiveError | None = None
    for segment in reversed(segment_paths(path)):
        try:
            return read_segment(segment, largest).channels
        except CorruptSegmentError as error:
            last = error
        except FileNotFoundError:
            continue
    raise last or ArchiveError(f"{path} holds no readable row; run the loop to record some")


def _transition(path: Path, read: Transitions, found: list[Finding]) -> Transition:
    read = read.by_correctors()
    # A row whose reading did not come has no time, and its neighbours are not usable.
    usable = read.usable & np.isfinite(read.time) & np.isfinite(read.setpoints).all(axis=1)
    if usable.sum() < FEWEST_ROWS:
        raise RecordError(
            f"{path}: {int(usable.sum())} of {len(read)} transitions can be used, {FEWEST_ROWS} "
            "are needed; record longer, with the loop closed"
        )
    shortened = (
        usable & read.closed & (np.abs(read.requested - read.applied) > _ROUNDING).any(axis=1)
    )
    if shortened.any():
        rows = np.flatnonzero(shortened)
        found.append(
            Finding(
                "limited-writes",
                "note",
                (),
                None,
                f"limits shortened {len(rows)} changes; what was written is taken",
            )
        )
    readback, missing = _readback(read, usable)
    found += missing
    whole = Transition(
        time=read.time,
        orbit=read.orbit,
        next_orbit=read.next_orbit,
        setpoints=read.setpoints,
        requested=read.applied,
        follows=~read.starts()[1:],
        readback=readback,
        dither=np.where(read.closed[:, None], read.dither, 0.0),
        reference=read.reference,
        auxiliary=_auxiliary(read, usable),
    )
    kept = whole.take(usable)
    if not (np.diff(kept.time) > 0).all():
        row = int(np.flatnonzero(np.diff(kept.time) <= 0)[0]) + 1
        raise RecordError(
            f"{path}: 'time' does not increase at usable row {row}; the clock was set back: give a "
            "segment from before or after"
        )
    return kept


def _readback(read: Transitions, usable: Mask) -> tuple[Vector | None, list[Finding]]:
    """Give the readbacks; where there are none the setpoint stands for them."""
    lacking = ~np.isfinite(read.readback)
    if not lacking[usable].any():
        return read.readback, []
    if lacking[usable].all():
        return None, []
    columns = np.flatnonzero(lacking[usable].any(axis=0))
    text = f"{len(columns)} correctors have ticks without a readback; their setpoint is taken there"
    return (
        np.where(lacking, read.setpoints, read.readback),
        [Finding("missing-readback", "note", (), None, text)],
    )


def _auxiliary(read: Transitions, usable: Mask) -> dict[str, Vector]:
    """Carry the last known value of every slow channel on."""
    rows = np.arange(len(read))
    channels: dict[str, Vector] = {}
    for name, values in read.auxiliary.items():
        valid = np.isfinite(values)
        if not valid[usable].any():
            continue
        last = np.maximum.accumulate(np.where(valid, rows, -1))
        channels[name] = values[np.where(last < 0, int(np.argmax(valid)), last)]
    return channels

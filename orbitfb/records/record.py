"""A record of operation as a sequence of readings, whatever file it came from."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """N consecutive readings, in one or more unbroken stretches.

    Row k holds what was read at one tick and the setpoints that were in force then. A stretch of
    T transitions is T + 1 rows: the `next_orbit` of its last transition is its last row.

    Args:
        layout: Devices, model, period.
        time: Of the reading, since the first one, shape (N,) [s].
        starts: Whether a row begins an unbroken stretch, shape (N,); the first one does.
        readings: What the BPMs told, finite, shape (N, n) [m].
        setpoints: In force at the reading, shape (N, m) [A].
        requested: Change that the controller asked for after the reading, shape (N, m) [A];
            NaN in the last row of a stretch.
        readback: Currents read back with the reading, shape (N, m) [A]; None if not recorded.
        dither: The dither's part of `requested`, shape (N, m) [A]; None if not recorded.
        reference: Reference orbit, shape (N, n) [m]; None if not recorded.
        filled: Readings that were missing and were filled in, shape (N, n).
        auxiliary: Slow channels by name, SI (`current` [A], `rf_frequency` [Hz]), each (N,).
        source: Where it came from, for people.
        digest: SHA-256 of what was read, hexadecimal.
        began: What the clock said at `time` = 0 [s]; 0 where nobody knows.
    """

    layout: Layout
    time: Vector
    starts: Mask
    readings: Matrix
    setpoints: Matrix
    requested: Matrix
    readback: Matrix | None
    dither: Matrix | None
    reference: Matrix | None
    filled: Mask
    auxiliary: Mapping[str, Vector]
    source: str
    digest: str
    began: float = 0.0

    def __len__(self) -> int:
        return len(self.time)

    def rows(self, start: int, stop: int) -> "Record":
        """A part of the record; its first row begins a stretch."""
        piece = slice(start, stop)
        starts = self.starts[piece].copy()
        starts[:1] = True

        def cut(columns: Matrix | None) -> Matrix | None:
            return None if columns is None else columns[piece]

        return Record(
            layout=self.layout,
            time=self.time[piece],
            starts=starts,
            readings=self.readings[piece],
            setpoints=self.setpoints[piece],
            requested=self.requested[piece],
            readback=cut(self.readback),
            dither=cut(self.dither),
            reference=cut(self.reference),
            filled=self.filled[piece],
            auxiliary={name: values[piece] for name, values in self.auxiliary.items()},
            source=self.source,
            digest=self.digest,
            began=self.began,
        )

    @property
    def stretches(self) -> list[slice]:
        """The unbroken stretches, in order."""
        begins = np.flatnonzero(self.starts)
        ends = [*begins[1:], len(self)]
        return [slice(int(begin), int(end)) for begin, end in zip(begins, ends, strict=True)]

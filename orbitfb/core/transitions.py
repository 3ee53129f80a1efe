"""Transitions (s_n, a_n, s_{n+1}): what the learner trains on and the archive keeps."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector


@dataclass(frozen=True, slots=True)
class Transitions:
    """T transitions as columns, in the order in which they happened.

    Args:
        tick: Tick of s_n, shape (T,).
        time: Stamp of s_n, shape (T,) [s since the epoch].
        next_time: Stamp of s_{n+1}, shape (T,) [s since the epoch].
        written: When a_n had been sent, shape (T,) [s since the epoch]; NaN if nothing was.
        orbit: s_n as read, shape (T, n) [m]; NaN where not valid.
        next_orbit: s_{n+1} as read, shape (T, n) [m].
        reference: Reference orbit, shape (T, n) [m].
        valid: BPM valid in s_n *and* in s_{n+1}, shape (T, n).
        requested: a_n as asked for by policy and dither, shape (T, m) [A].
        applied: a_n as written, shape (T, m) [A].
        dither: The dither's part of `requested`, shape (T, m) [A].
        setpoints: In force when s_n was read, shape (T, m) [A].
        readback: At s_n, shape (T, m) [A].
        policy_id: Who decided, shape (T,), strings.
        closed: Whether the loop was CLOSED at s_n, shape (T,).
        hertz: Step of the RF frequency that went with a_n, shape (T,) [Hz]; 0: none did.
        usable: Whether s_{n+1} is the very next orbit and a_n is known to be in it, shape (T,).
        auxiliary: Slow channels by name, each of shape (T,), SI.
    """

    tick: NDArray[np.int64]
    time: Vector
    next_time: Vector
    written: Vector
    orbit: Vector
    next_orbit: Vector
    reference: Vector
    valid: Mask
    requested: Vector
    applied: Vector
    dither: Vector
    setpoints: Vector
    readback: Vector
    policy_id: NDArray[np.str_]
    closed: Mask
    hertz: Vector
    usable: Mask
    auxiliary: Mapping[str, Vector]

    def __len__(self) -> int:
        return len(self.tick)

    def by_correctors(self) -> "Transitions":
        """Give the same for whoever does not know the RF: rows in which it stepped not usable."""
        return replace(self, usable=self.usable & (self.hertz == 0.0))

    def part(self, begin: int, end: int | None = None) -> "Transitions":
        """Give the rows of a range; negative numbers count from the end."""
        columns = {
            name: getattr(self, name)[begin:end]
            for name in self.__dataclass_fields__
            if name != "auxiliary"
        }
        auxiliary = {name: column[begin:end] for name, column in self.auxiliary.items()}
        return Transitions(**columns, auxiliary=auxiliary)

    def starts(self) -> Mask:
        """Rows where a new unbroken stretch begins, shape (T,).

        Within a stretch the s_{n+1} of a row is the s_n of the next one.
        """
        broken = np.ones(len(self), dtype=np.bool_)
        broken[1:] = (np.diff(self.tick) != 1) | ~self.usable[:-1]
        return broken

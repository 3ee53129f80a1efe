"""What is read from the machine, what is sent to it, and what one tick leaves behind."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import lru_cache
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Mask = NDArray[np.bool_]

FINEST = 1e-9
"""Noise of a reading below which no BPM reads [m]: the best of rings have tens of nanometres."""


@dataclass(frozen=True, slots=True)
class Channels:
    """The names behind the elements of an orbit (n) and of a set of setpoints (m).

    Vectors are x first, then y, in the order of the places table.

    Args:
        planes: `x`, `y` or `xy`.
        bpms: n names of BPMs, as in the places table.
        correctors: m names of correctors.
        orbit_pvs: n PVs of the readings.
        setpoint_pvs: m PVs of the setpoints [A].
        readback_pvs: m PVs of the readbacks [A]; empty where a corrector has none.
        bpm_counts: How many of the n are in each plane; empty: as many in each.
        corrector_counts: How many of the m are in each plane; empty: as many in each.
        bpm_units: Unit of each reading at its PV, n texts, empty where that is not said; or nothing
            at all.
    """

    planes: str
    bpms: tuple[str, ...]
    correctors: tuple[str, ...]
    orbit_pvs: tuple[str, ...]
    setpoint_pvs: tuple[str, ...]
    readback_pvs: tuple[str, ...]
    bpm_counts: tuple[int, ...] = ()
    corrector_counts: tuple[int, ...] = ()
    bpm_units: tuple[str, ...] = ()

    @property
    def pvs(self) -> tuple[str, ...]:
        """All PVs: readings, setpoints, readbacks."""
        return (*self.orbit_pvs, *self.setpoint_pvs, *self.readback_pvs)

    @property
    def bpm_parts(self) -> dict[str, slice]:
        """Where the BPMs of each plane are in an orbit."""
        return parts(self.planes, len(self.bpms), self.bpm_counts)

    @property
    def bpm_planes(self) -> tuple[str, ...]:
        """The plane of each of the n readings."""
        return planes_in(self.bpm_parts)

    @property
    def corrector_planes(self) -> tuple[str, ...]:
        """The plane of each of the m setpoints."""
        return planes_in(self.corrector_parts)

    @property
    def corrector_parts(self) -> dict[str, slice]:
        """Where the correctors of each plane are in a set of setpoints."""
        return parts(self.planes, len(self.correctors), self.corrector_counts)


def parts(planes: str, size: int, counts: Sequence[int] = ()) -> dict[str, slice]:
    """Cut a vector into its planes.

    Args:
        planes: `x`, `y` or `xy`.
        size: Length of the vector.
        counts: How many elements each plane has; empty: as many each.
    """
    return dict(_cut(planes, size, tuple(counts)))


@lru_cache(maxsize=64)
def _cut(planes: str, size: int, counts: tuple[int, ...]) -> tuple[tuple[str, slice], ...]:
    """Cut it once: the loop asks at every tick."""
    each = counts or (size // len(planes),) * len(planes)
    ends = accumulate(each)
    return tuple(
        (plane, slice(end - count, end))
        for plane, count, end in zip(planes, each, ends, strict=True)
    )


COUNTS = ("bpm_counts", "corrector_counts")
"""Fields of `Channels` that say how many devices each plane has; files keep them where they are not
the same for all."""


def planes_in(parts: Mapping[str, slice]) -> tuple[str, ...]:
    """Give the plane of each element of a vector that is cut into planes."""
    return tuple(plane for plane, part in parts.items() for _ in range(part.stop - part.start))


@dataclass(frozen=True, slots=True)
class Orbit:
    """One coherent orbit: every reading carries the same stamp.

    Args:
        position: Shape (n,) [m]; NaN where not valid.
        valid: Shape (n,); False for a BPM that is disconnected, INVALID or not finite.
        time: The common stamp [s since the epoch].
    """

    position: Vector
    valid: Mask
    time: float


@dataclass(frozen=True, slots=True)
class Reading:
    """All that one read of the machine returns.

    Args:
        orbit: The coherent orbit.
        readback: Corrector readbacks, shape (m,) [A]; NaN where none is known. Of a corrector that
            has none, the setpoint in force as the machine posts it.
        auxiliary: Slow channels by name, SI: `current` [A], `rf_frequency` [Hz], others as
            configured; NaN where none is known.
        received: When the orbit was complete, on the monotonic clock [s].
        away: Correctors whose setpoint cannot be written now, shape (m,); None: all can.
        behind: Correctors whose readback was taken before the orbit, or that have none, shape (m,);
            None: none.
        left_out: Why connected BPMs are not in the orbit, by index.
        refused: Why correctors did not take what was put to them since the last read, by index.
        unknown: Why slow channels are not known, by name, for those that are not.
        moves: How often a PV came back from another server than before.
        moved: The last of these moves, in words.
        by_others: Correctors whose setpoint somebody else has put since the last read, shape
            (m,); None: none.
    """

    orbit: Orbit
    readback: Vector
    auxiliary: Mapping[str, float]
    received: float
    away: Mask | None = None
    behind: Mask | None = None
    left_out: Mapping[int, str] = field(default_factory=dict[int, str])
    refused: Mapping[int, str] = field(default_factory=dict[int, str])
    unknown: Mapping[str, str] = field(default_factory=dict[str, str])
    moves: int = 0
    moved: str = ""
    by_others: Mask | None = None


@dataclass(frozen=True, slots=True)
class Applied:
    """What a write did.

    Args:
        setpoints: What was sent, shape (m,) [A]; elsewhere what was handed over.
        time: When the last one had left, wall clock [s since the epoch].
        monotonic: The same moment on the monotonic clock [s].
    """

    setpoints: Vector
    time: float
    monotonic: float


class LoopState(StrEnum):
    """States of the loop."""

    OPEN = "OPEN"
    """Reads and records; decides nothing."""
    SHADOW = "SHADOW"
    """Decides and records what it would do; never writes."""
    CLOSED = "CLOSED"
    """Decides and writes."""
    HELD = "HELD"
    """Was CLOSED; writes nothing until the cause is gone, then closes again by itself."""
    TRIPPED = "TRIPPED"
    """An interlock opened the loop; latched with its reason until an operator resets it."""
    FAULT = "FAULT"
    """The program itself failed; nothing is written; restart after reading the log."""


@dataclass(frozen=True, slots=True)
class Phases:
    """How long each phase of a tick took [s]. `read` is the wait for the orbit."""

    read: float
    check: float
    decide: float
    limit: float
    act: float


@dataclass(frozen=True, slots=True)
class TickRecord:
    """Everything one tick leaves behind; what subscribers get.

    Args:
        tick: Count of ticks since the loop was built.
        state: State in which the tick ended.
        reason: Why it is in that state; empty when there is nothing to say.
        reading: What was read; None when no coherent orbit came (then nothing was decided).
        reference: Reference orbit, shape (n,) [m].
        setpoints: Absolute setpoints in force when the orbit was read, shape (m,) [A].
        requested: Change that policy and dither asked for, shape (m,) [A]; zeros if none.
        dither: The dither's part of `requested`, shape (m,) [A].
        applied: Change that was written, shape (m,) [A]; zeros if none was.
        scale: Factor by which the limits shortened `requested` (1 if untouched).
        written: When the write had left, wall clock [s]; NaN if none was.
        policy_id: The policy that decided.
        phases: Duration of each phase [s].
        latency: From the complete orbit to the last setpoint sent [s]; NaN if none was.
        missed: Orbits that should have come since the last tick and did not.
        held_back: Whether a closed loop wrote nothing as its last change did not show in the
            readbacks of this orbit yet.
    """

    tick: int
    state: LoopState
    reason: str
    reading: Reading | None
    reference: Vector
    setpoints: Vector
    requested: Vector
    dither: Vector
    applied: Vector
    scale: float
    written: float
    policy_id: str
    phases: Phases
    latency: float
    missed: int
    held_back: bool = False

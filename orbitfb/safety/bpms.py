"""Readings of single BPMs that must not be believed, though they look like numbers.

A dead channel reads exactly 0, which a feedback takes for "on the axis"; a hung one repeats
itself; a bad one jumps while its neighbours stay. Each is left out at once and comes back by
itself once it has been good for some orbits in a row.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.robust import median
from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.repeating import Habit
from orbitfb.safety.verdict import FINE, Action, Verdict

Flaws = NDArray[np.int8]

ALONE = 10.0
"""A BPM jumps only if it moves so many times as far as the median of its plane: a beam that is
kicked moves everywhere (largest / median of a closed orbit is below 5)."""

Planes = int | Sequence[slice]
"""How many planes of one size lie one after the other in a vector, or where each of them is."""


class Flaw(IntEnum):
    """What is wrong with a reading; the first that holds."""

    NONE = 0
    INVALID = 1
    ZERO = 2
    FROZEN = 3
    JUMP = 4
    PROVING = 5
    SILENT = 6


WORDS = {
    Flaw.INVALID: "invalid",
    Flaw.ZERO: "exactly 0",
    Flaw.FROZEN: "frozen",
    Flaw.JUMP: "jumped",
    Flaw.PROVING: "proving",
    Flaw.SILENT: "does not answer the correctors",
}

LATCHED = "; those that jumped or do not answer count again after open and close"
"""Said when the loop is held by BPMs that an operator has to look at."""


@dataclass(frozen=True, slots=True)
class BpmMemory:
    """What is remembered of every BPM.

    Args:
        last: Readings of the orbit before, shape (n,) [m].
        base: Orbit error when the BPM was last believed, shape (n,) [m]; NaN: not known.
        repeats: How often in a row each brought the same reading again, shape (n,).
        good: Good readings in a row, counted up to the proving, shape (n,).
        habit: How often each repeats itself when it is well; None: nothing is known yet.
        then: `base` of all BPMs when one that is not believed now was believed last, by its
            index, each of shape (n,) [m].
    """

    last: Vector
    base: Vector
    repeats: NDArray[np.int64]
    good: NDArray[np.int64]
    then: Mapping[int, Vector] = field(default_factory=dict[int, Vector])
    habit: Habit | None = None

    @classmethod
    def first(cls, size: int, settings: InterlockSettings) -> "BpmMemory":
        """Believe every BPM to begin with.

        Args:
            size: n.
            settings: Has the proving.
        """
        unknown, none = np.full(size, np.nan), np.zeros(size, dtype=np.int64)
        return cls(unknown, unknown, none, np.full(size, settings.bpm_proving))


def screen(
    position: Vector,
    error: Vector,
    valid: Mask,
    memory: BpmMemory,
    settings: InterlockSettings,
    planes: Planes = 1,
    latching: bool = True,
) -> tuple[Flaws, BpmMemory]:
    """Judge every reading of an orbit.

    A BPM that jumped stays out until it reads again what it did, or until the loop is opened:
    a step of one BPM alone is a fault of that BPM, however long it lasts.

    Args:
        position: As read, shape (n,) [m].
        error: The same less the reference, shape (n,) [m].
        valid: What the machine calls valid, shape (n,).
        memory: What the last call returned.
        settings: Thresholds.
        planes: How many planes of one size lie one after the other in the vectors, or where each
            of them is.
        latching: Whether jumps count: the loop is CLOSED or HELD.

    Returns:
        A `Flaw` for every BPM, shape (n,), and the new memory.
    """
    known = valid & np.isfinite(position)
    same = known & (position == memory.last)
    repeats, habit = memory.repeats, memory.habit or Habit.none(len(position))
    zero = known & (position == 0.0)
    if zero.any():
        zero &= ~habit.is_coarse & settings.bpm_zero
    limit: NDArray[np.int64] | int = settings.bpm_frozen_ticks
    if int(repeats.max(initial=0)) + 1 >= limit:  # nobody is frozen before
        limit = habit.frozen_from(settings.bpm_frozen_ticks)
    if not np.array_equal(same, known):  # an orbit that repeats itself as a whole: `repeated`
        changed = known & ~same & np.isfinite(memory.last)
        teaches = changed & (memory.last != 0.0)  # a dead channel that comes back is not coarse
        habit = habit.learn(teaches, repeats, limit)
        repeats = np.where(same, repeats + 1, 0)
    frozen = np.zeros_like(known)
    if settings.frozen_ticks and settings.bpm_frozen_ticks:
        frozen = known & (repeats >= limit)
    jump = np.zeros_like(known)
    if latching:
        jump = known & _jumped(error, memory, settings.bpm_jump, planes)
    flaws = np.zeros(position.shape, dtype=np.int8)
    good = np.minimum(memory.good + 1, settings.bpm_proving)
    bad = jump | frozen | zero | ~known
    base = error
    if bad.any():
        for flaw, mask in (
            (Flaw.JUMP, jump),
            (Flaw.FROZEN, frozen),
            (Flaw.ZERO, zero),
            (Flaw.INVALID, ~known),
        ):
            flaws[mask] = flaw
        good, base = np.where(bad, 0, good), np.where(bad, memory.base, error)
    flaws[~bad & (good < settings.bpm_proving)] = Flaw.PROVING
    then = {index: memory.then.get(index, memory.base) for index in np.flatnonzero(bad).tolist()}
    return flaws, BpmMemory(position, base, repeats, good, then, habit)


def _jumped(error: Vector, memory: BpmMemory, limit: float, planes: Planes) -> Mask:
    """Find the BPMs that moved far, and much farther than the others of their plane since then.

    Channels come back from an outage in waves: one that comes late must not be told from the
    others by the way that all of them went before.
    """
    step = np.abs(error - memory.base)
    far = step > limit  # False where nothing is known
    moved: dict[int, Vector] = {}
    parts = parts_of(planes, len(error))
    for index in np.flatnonzero(far).tolist():
        then = memory.then.get(index, memory.base)
        if id(then) not in moved:
            moved[id(then)] = _moved(error - then, parts)
        far[index] = step[index] > ALONE * moved[id(then)][index]
    return far


def _moved(step: Vector, parts: Sequence[slice]) -> Vector:
    """Give how far the median BPM of the plane of each moved, shape (n,) [m]."""
    size, moved = np.abs(step), np.zeros(len(step))
    for part in parts:
        known = size[part][np.isfinite(size[part])]
        moved[part] = median(known) if known.size else 0.0
    return moved


def parts_of(planes: Planes, size: int) -> tuple[slice, ...]:
    """Cut a vector into its planes.

    Args:
        planes: How many of one size, or where each of them is.
        size: Length of the vector.
    """
    if not isinstance(planes, int):
        return tuple(planes)
    own = size // planes
    return tuple(slice(first, first + own) for first in range(0, size, own))


def longest_run(bad: Mask) -> int:
    """Count the longest unbroken row of a ring, whose last element is next to its first.

    Args:
        bad: Shape (n,).
    """
    if bad.all():
        return len(bad)
    start = int(np.argmin(bad))  # begin at a good one: no run goes through the seam
    edges = np.flatnonzero(np.diff(np.concatenate(([0], np.roll(bad, -start), [0]))))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def bpm_quota(
    valid: Mask,
    settings: InterlockSettings,
    names: Sequence[str] = (),
    counting: Mask | None = None,
    flaws: Flaws | None = None,
    planes: Planes = 1,
    told: Mapping[int, str] | None = None,
) -> Verdict:
    """Let a few BPMs be invalid, not more, not too many next to each other, and never all.

    Args:
        valid: Shape (n,).
        settings: Thresholds.
        names: The BPMs, for the reason.
        counting: BPMs that are not masked by configuration, shape (n,): what the others read does
            not matter, so they do not use up the quota; None: all.
        flaws: Why each is invalid, for the reason; from `screen`.
        planes: See `screen`.
        told: What the machine says of single BPMs, by index.
    """
    bad = ~valid if counting is None else counting & ~valid
    invalid = int(np.count_nonzero(bad))
    if invalid == 0:
        return FINE
    counted = np.ones_like(valid) if counting is None else counting
    wanted = int(np.count_nonzero(counted))
    reason = f"{invalid} of {wanted} BPMs are invalid: {_name_flaws(bad, names, flaws, told or {})}"
    if flaws is not None and (flaws[bad] == Flaw.FROZEN).any():
        reason += "; frozen: longer than usual at one reading (interlocks.bpm_frozen_ticks)"
    latched = flaws is not None and np.isin(flaws[bad], (Flaw.JUMP, Flaw.SILENT)).any()
    remedy = LATCHED if latched else ""
    if invalid > settings.max_invalid_bpms or invalid == wanted:
        allowed = f"; allowed: {settings.max_invalid_bpms}{remedy}"
        return Verdict(Action.HOLD, "bpm_quota", reason + allowed)
    parts = [part for part in parts_of(planes, len(bad)) if counted[part].any()]
    run = max(longest_run(bad[part][counted[part]]) for part in parts)
    if run > settings.max_adjacent_bpms:
        return Verdict(
            Action.HOLD,
            "bpm_quota",
            f"{reason}; {run} of them next to each other, allowed: {settings.max_adjacent_bpms}"
            f"{remedy}",
        )
    return Verdict(Action.WARN, "bpm_quota", reason)


def _name_flaws(
    bad: Mask,
    names: Sequence[str],
    flaws: Flaws | None,
    told: Mapping[int, str],
    at_most: int = 5,
) -> str:
    where = [int(index) for index in np.flatnonzero(bad)]
    shown: list[str] = []
    for index in where[:at_most]:
        name = names[index] if names else f"#{index}"
        flaw = Flaw.INVALID if flaws is None else Flaw(int(flaws[index]))
        plain = flaw in (Flaw.NONE, Flaw.INVALID)
        why = told.get(index, "" if plain else WORDS[flaw])
        shown.append(f"{name} ({why})" if why else name)
    more = len(where) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")

"""Correctors that do not do what they are told: left out, and too many of them trip."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask, Vector
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.verdict import Action, Verdict, name_some
from orbitfb.safety.watch import readback as not_yet


@dataclass(frozen=True, slots=True)
class Following:
    """How the correctors follow.

    Args:
        verdict: What to do.
        counts: Ticks in a row that each did not follow, shape (m,).
        lost: Correctors to leave out, shape (m,).
        sure: Those of the ticks in which it was there and its readback known, shape (m,).
    """

    verdict: Verdict
    counts: NDArray[np.int64]
    lost: Mask
    sure: NDArray[np.int64]


def follow(
    off: Mask,
    readback: Vector,
    counts: NDArray[np.int64],
    lost: Mask,
    settings: InterlockSettings,
    names: Sequence[str] = (),
    acting: bool = True,
    held: bool = False,
    leaves_out: bool = True,
    away: Mask | None = None,
    sure: NDArray[np.int64] | None = None,
    told: Mapping[int, str] | None = None,
    refusing: Mask | None = None,
) -> Following:
    """Leave out what does not follow its setpoint for some ticks in a row.

    Args:
        off: Correctors that matter and do not follow now, shape (m,).
        readback: Shape (m,) [A]; NaN where none is known.
        counts: Ticks in a row so far, shape (m,).
        lost: Correctors that are left out already, shape (m,).
        settings: Thresholds.
        names: The correctors, for the reason.
        acting: Whether the loop writes, or waits to; else any that is off keeps it from closing.
        held: Whether the loop waits for a fault to go: it does not return meanwhile.
        leaves_out: Whether any can be left out; else those that are off hold the loop.
        away: Those whose setpoint cannot be written, shape (m,): left out at once; None: none.
        sure: Ticks in a row so far in which it did not follow, was there and its readback known,
            shape (m,); None: none. One that is back has not done anything wrong yet.
        told: Why some do not follow, by index.
        refusing: Those that do not take what is put to them, shape (m,): left out at once; None:
            none.
    """
    refusing = np.zeros_like(off) if refusing is None else refusing & ~lost
    gone = np.zeros_like(off) if away is None else away & ~lost
    off = off | gone | refusing
    known = off & ~gone & np.isfinite(readback)
    sure = np.where(known, 1 if sure is None else sure + 1, 0)
    ticks = settings.readback_ticks if acting else 1
    verdict, counts = not_yet(off & ~lost, counts, ticks, names)
    if not acting or not leaves_out:
        return Following(verdict, counts, lost, sure)
    new = (counts >= ticks) | gone | refusing
    out = lost | new
    count = int(np.count_nonzero(out))
    if count > settings.max_lost_correctors and new.any():
        absent = bool((new & ~(refusing & ~gone) & (sure < ticks)).any())
        reason = (
            f"{count} correctors do not follow their setpoint: {name_some(out, names, told=told)}; "
            f"allowed: {settings.max_lost_correctors}"
        )
        action = Action.HOLD if absent else Action.TRIP  # an IOC that is away may come back
        return Following(Verdict(action, "readback", reason), counts, lost, sure)
    if held and (off & ~out).any():
        return Following(Verdict(Action.HOLD, "readback", verdict.reason), counts, out, sure)
    if not out.any():
        return Following(verdict, counts, out, sure)
    reason = (
        f"{count} correctors do not follow and are left out: {name_some(out, names, told=told)}"
    )
    return Following(Verdict(Action.WARN, "readback", reason), counts, out, sure)

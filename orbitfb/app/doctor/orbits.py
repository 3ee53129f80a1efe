"""What the BPMs send: whether orbits would form of it, at which rate, and who repeats itself."""

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from orbitfb.app.doctor.finding import Finding, Verdict
from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.records import NANOSECONDS, stamps_of
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.settings import LoopSettings
from orbitfb.safety.verdict import name_some

_PART = "ring"
ENOUGH = 20
"""Readings of each BPM after which no more is listened for: a rate to 5 %, a habit to 20 %."""

LEAST = 3
"""Readings of each BPM without which no rate is told."""

OFTEN = 0.05
"""Share of repeats that is told: one in the `ENOUGH` readings that are listened for."""


class Listener:
    """Hears the readings of n BPMs, and assembles orbits of them as the loop would.

    Args:
        size: n.
        settings: Window and patience of the assembler.
    """

    def __init__(self, size: int, settings: EpicsSettings) -> None:
        self.assembler = Assembler(size, settings.stamp_window, settings.stuck_bpms)
        self.orbits = 0
        """Orbits that formed."""
        self._last: NDArray[np.int64] = np.zeros(size, dtype=np.int64)
        self._heard: list[list[tuple[int, float]]] = [[] for _ in range(size)]

    def arrived(self, values: int = 1) -> bool:
        """Note readings that have come together; called on libca's thread."""
        records = self.assembler.records
        stamps = stamps_of(records)
        for index in np.flatnonzero(stamps != self._last).tolist():
            self._heard[index].append((int(stamps[index]), float(records["value"][index])))
        self._last = stamps
        return self.assembler.arrived(values)

    def complete(self) -> None:
        """Count an orbit; called on libca's thread."""
        self.assembler.snapshot()
        self.orbits += 1

    @property
    def fewest(self) -> int:
        """Readings of the median BPM so far."""
        return int(np.median([len(its) for its in self._heard]))

    def readings(self) -> list[tuple[NDArray[np.int64], Vector]]:
        """Give stamps [ns] and values of each BPM, without the one that was there before."""
        return [
            (np.array([s for s, _ in its[1:]], dtype=np.int64), np.array([v for _, v in its[1:]]))
            for its in self._heard
        ]


def judge(
    listener: Listener, names: tuple[str, ...], settings: EpicsSettings, loop: LoopSettings
) -> Iterator[Finding]:
    """Say what the loop would make of what was heard.

    Args:
        listener: Has heard it.
        names: The n PVs.
        settings: Window of the stamps.
        loop: Has the rate.
    """
    readings = listener.readings()
    counts = np.array([len(stamps) for stamps, _ in readings])
    usual = int(np.median(counts))
    if usual < LEAST:
        told = f"{usual} new readings of most BPMs were heard, too few to tell a rate"
        yield Finding(_PART, "orbits", Verdict.WARNING, told, "see whether the BPMs update; a "
                      "longer --deadline helps a slow ring")  # fmt: skip
        return
    rate = _rate(readings[int(np.argmax(counts))][0])
    spread = _spread(readings, 1.0 / rate, settings.stuck_bpms)
    told = f"{listener.orbits} came at {rate:.3g} Hz, stamps of one {spread:.3g} s apart"
    figures = {"orbits": listener.orbits, "rate_hz": rate, "spread_s": spread}
    verdict, advice = Verdict.OK, ""
    if spread > settings.stamp_window:
        verdict = Verdict.FAILED
        told += f", epics.stamp_window = {settings.stamp_window:g}: none would form"
        window = _rounded_up(2.0 * spread)
        advice = (
            f"set epics.stamp_window = {window:g}"
            if window < 1.0 / rate / 2
            else "let the IOC stamp the BPMs of a tick alike (TSEL)"
        )
    elif rate < (1.0 - 1.0 / ENOUGH) * loop.rate_hz:
        verdict = Verdict.FAILED if loop.hold_after * rate < loop.rate_hz else Verdict.WARNING
        told += f", loop.rate_hz is {loop.rate_hz:g}"
        advice = f"set loop.rate_hz = {rate:.2g}"
    yield Finding(_PART, "orbits", verdict, told, advice, figures)
    few = counts < 0.8 * usual
    if few.any():
        yield Finding(
            _PART,
            "updates",
            Verdict.WARNING,
            f"{int(few.sum())} of {len(names)} BPMs sent fewer readings than the others: "
            f"{name_some(few, names)}",
            "let the records post each reading, also one that has not changed (MDEL = -1)",
        )
    yield from _repeats(readings, names)


def _repeats(
    readings: list[tuple[NDArray[np.int64], Vector]], names: tuple[str, ...]
) -> Iterator[Finding]:
    share = np.array([np.mean(np.diff(v) == 0) if len(v) > 1 else 0.0 for _, v in readings])
    often: Mask = (share >= OFTEN) & (share < 1)
    if often.any():
        told = (
            f"{int(often.sum())} of {len(names)} BPMs repeat a reading now and then, one in "
            f"{np.max(share[often]):.0%} of ticks: the last digit is as large as the noise"
        )
        advice = (
            "the loop learns it and waits for longer runs than interlocks.bpm_frozen_ticks; more "
            "digits of the PVs are better"
        )
        figures = {"repeating": int(often.sum()), "largest_share": float(np.max(share[often]))}
        yield Finding(_PART, "repeats", Verdict.OK, told, advice, figures)
    dead: Mask = share >= 1
    if dead.any():
        told = f"{int(dead.sum())} of {len(names)} BPMs never changed: {name_some(dead, names)}"
        yield Finding(_PART, "frozen", Verdict.WARNING, told, "see whether these BPMs are alive")


def _rate(stamps: NDArray[np.int64]) -> float:
    """Give the readings per second of one BPM [Hz], lost ones not counted."""
    return NANOSECONDS / float(np.median(np.diff(stamps)))


def _spread(readings: list[tuple[NDArray[np.int64], Vector]], period: float, odd: int) -> float:
    """Give how far the stamps of one tick lie apart [s], without the few that are odd."""
    reference = max((stamps for stamps, _ in readings), key=len)
    offsets = np.zeros((len(reference), len(readings)))
    for index, (stamps, _) in enumerate(readings):
        apart = stamps[None, :] - reference[:, None]
        offsets[:, index] = (
            apart[np.arange(len(reference)), np.abs(apart).argmin(axis=1)] if stamps.size else 0.0
        )
    near = np.sort(np.abs(offsets - np.median(offsets, axis=1)[:, None]), axis=1)
    kept = near[:, : max(1, near.shape[1] - odd)]
    # What is half a period away is of another tick: that reading was lost.
    inside = kept[kept < period / 2 * NANOSECONDS]
    return 2.0 * float(inside.max(initial=0.0)) / NANOSECONDS


def _rounded_up(value: float) -> float:
    """Give the next of 1, 2, 5, 10, … times a power of ten."""
    if value <= 0:
        return 0.0
    power = 10.0 ** math.floor(math.log10(value))
    return next(step * power for step in (1, 2, 5, 10) if step * power >= value * (1 - 1e-9))

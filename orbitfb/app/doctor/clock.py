"""The wall clock: orbits are believed or refused by their stamps, so it must be right."""

import ctypes
import ctypes.util
import sys
import time
from collections.abc import Iterator

from orbitfb.app.doctor.finding import Finding, Verdict

_PART = "clock"
_BUILT = 1_735_689_600.0
"""2025-01-01: a clock before it was never set [s since the epoch]."""

_ERROR = 5
_LONGS = 26
_UNSYNCHRONISED = 0x0040


def look_at_clock() -> Iterator[Finding]:
    """Look at the time, and at whether the kernel says that somebody keeps it right."""
    now = time.time()
    told = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(now))
    if now < _BUILT:
        yield Finding(_PART, "time", Verdict.FAILED, f"{told} was long ago", "set the clock")
    else:
        yield Finding(_PART, "time", Verdict.OK, told, figures={"time_s": now})
    yield _synchronised()


def _synchronised() -> Finding:
    """Ask the kernel (adjtimex with no mode only reads; Linux alone has it)."""
    status = _kernel_status()
    if status is None:
        return Finding(_PART, "synchronised", Verdict.SKIPPED, "this system does not say")
    if not status:
        return Finding(
            _PART,
            "synchronised",
            Verdict.WARNING,
            "the clock is not synchronised (no NTP)",
            "run chrony or another NTP client, unless the host of this container does: orbits "
            "older than epics.stale_after by their stamps are refused",
            {"synchronised": False},
        )
    return Finding(_PART, "synchronised", Verdict.OK, "by the kernel's word",
                   figures={"synchronised": True})  # fmt: skip


def _kernel_status() -> bool | None:
    if not sys.platform.startswith("linux") or ctypes.sizeof(ctypes.c_long) != 8:
        return None
    try:
        library = ctypes.CDLL(ctypes.util.find_library("c") or "libc.so.6")
        buffer = (ctypes.c_long * _LONGS)()  # struct timex with modes = 0
        state = library.adjtimex(ctypes.byref(buffer))
    except (OSError, AttributeError):
        return None
    # modes, offset, freq, maxerror, esterror, status: each in a word of its own on 64 bits.
    status = ctypes.cast(buffer, ctypes.POINTER(ctypes.c_int))[10]
    return None if state < 0 else state != _ERROR and not status & _UNSYNCHRONISED

"""A timer that keeps its beat to a tenth of a millisecond.

asyncio's own timers round up to whole milliseconds. A Linux timerfd does not, and it keeps its
phase whatever the callbacks cost; beats that nobody could take are dropped, not queued.
"""

import asyncio
import contextlib
import ctypes
import os
from collections.abc import Callable
from typing import Protocol

_CLOCK_MONOTONIC = 1


class _Itimerspec(ctypes.Structure):
    _fields_ = [
        ("interval_seconds", ctypes.c_long),
        ("interval_nanoseconds", ctypes.c_long),
        ("first_seconds", ctypes.c_long),
        ("first_nanoseconds", ctypes.c_long),
    ]


class Ticker(Protocol):
    """Calls back at a fixed period."""

    def restart(self) -> None:
        """Let the next beat come one period from now."""
        ...

    def stop(self) -> None:
        """Beat no more."""
        ...


class TimerfdTicker:
    """Beats by a timerfd in the running event loop.

    Args:
        period: Time between beats [s].
        beat: What to call.

    Raises:
        OSError: This system has no timerfd.
    """

    def __init__(self, period: float, beat: Callable[[], None]) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        if not hasattr(self._libc, "timerfd_create"):
            raise OSError("no timerfd on this system")
        self._beat = beat
        self._loop = asyncio.get_running_loop()
        self._file = self._check(
            self._libc.timerfd_create(_CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC)
        )
        seconds, nanoseconds = divmod(max(1, round(period * 1e9)), 1_000_000_000)
        self._spec = _Itimerspec(seconds, nanoseconds, seconds, nanoseconds)
        self._loop.add_reader(self._file, self._expired)
        self.restart()

    def restart(self) -> None:
        """Let the next beat come one period from now."""
        self._check(self._libc.timerfd_settime(self._file, 0, ctypes.byref(self._spec), None))

    def stop(self) -> None:
        """Beat no more."""
        self._loop.remove_reader(self._file)
        os.close(self._file)

    def _expired(self) -> None:
        with contextlib.suppress(BlockingIOError):  # restarted since the loop saw it expire
            os.read(self._file, 8)
            self._beat()

    @staticmethod
    def _check(result: int) -> int:
        if result < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))
        return result


class LoopTicker:
    """Beats by the event loop's own timer, where there is no timerfd.

    Args:
        period: Time between beats [s].
        beat: What to call.
    """

    def __init__(self, period: float, beat: Callable[[], None]) -> None:
        self._period = period
        self._beat = beat
        self._loop = asyncio.get_running_loop()
        self._handle: asyncio.TimerHandle | None = None
        self.restart()

    def restart(self) -> None:
        """Let the next beat come one period from now."""
        self._schedule(self._loop.time() + self._period)

    def stop(self) -> None:
        """Beat no more."""
        if self._handle is not None:
            self._handle.cancel()

    def _schedule(self, when: float) -> None:
        self.stop()
        self._handle = self._loop.call_at(when, self._expired, when)

    def _expired(self, due: float) -> None:
        late = max(0.0, self._loop.time() - due)
        self._schedule(due + (late // self._period + 1) * self._period)
        self._beat()


def start_ticker(period: float, beat: Callable[[], None]) -> Ticker:
    """Start the best ticker of this system."""
    try:
        return TimerfdTicker(period, beat)
    except OSError:
        return LoopTicker(period, beat)

"""The signals that stop a service: the start at once, the loop in good order."""

import os
import signal
import threading
from typing import Self


class StopSignals:
    """Let SIGINT, SIGTERM and SIGHUP stop the service.

    Until `stop` is handed to a loop that heeds it, that is while the service starts, they end
    the start at once: what is open is closed, the exit code says which signal it was. A library
    may swallow that end or take it for a failure of its own, so it is remembered. A second
    signal while the loop stops ends the process there and then.
    """

    def __init__(self) -> None:
        self.stop = threading.Event()
        self._running = False
        self._ended_by = 0

    def hand_over(self) -> None:
        """Let the signals set `stop` from now on: a loop heeds it.

        Raises:
            SystemExit: One came during the start, and nobody noticed.
        """
        self._end()
        self._running = True

    def _end(self) -> None:
        if self._ended_by and not self._running:
            raise SystemExit(128 + self._ended_by)

    def _handle(self, number: int, _frame: object) -> None:
        if not self._running:
            self._ended_by = number
            self._end()
        if self.stop.is_set():
            os._exit(128 + number)
        self.stop.set()

    def __enter__(self) -> Self:
        """Take the signals."""
        # a closed window sends SIGHUP, unless whoever started the service wants it to stay (nohup)
        stays = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
        numbers = (signal.SIGINT, signal.SIGTERM, *(() if stays else (signal.SIGHUP,)))
        self._before = {number: signal.signal(number, self._handle) for number in numbers}
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._end()

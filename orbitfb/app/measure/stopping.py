"""Signals ask a measurement to stop; none ends it before the setpoints are back."""

import signal
from typing import Self


class StopRequests:
    """Take SIGINT, SIGTERM and SIGHUP for the wish to stop: the setpoints are put back first.

    However many come, each only says so again: a process that ended at the second would leave
    correctors where they are.

    Attributes:
        number: Of the first signal; 0: none came.
        at_once: A signal ends the program there and then: somebody is asked a question, and
            nothing has been moved.
    """

    def __init__(self) -> None:
        self.number = 0
        self.at_once = False

    def asked(self) -> bool:
        """Say whether one came."""
        return self.number != 0

    def _handle(self, number: int, _frame: object) -> None:
        self.number = self.number or number
        if self.at_once:
            raise SystemExit(128 + number)

    def __enter__(self) -> Self:
        """Take the signals."""
        numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        self._before = {number: signal.signal(number, self._handle) for number in numbers}
        return self

    def __exit__(self, *_: object) -> None:
        """Give them back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)

"""Lends the machine of an open loop and serves the borrower, tick by tick.

The loop stays the only one that talks to the machine: it reads every orbit, asks its interlocks,
then carries out what the borrower asks for until that waits for the next orbit. A procedure that
is written as a plain sequence of reads and writes runs so beside a loop that goes on ticking,
recording and watching.
"""

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import Empty
from typing import Protocol, TypeVar

import numpy as np

from orbitfb.core.errors import NoOrbitError, WriteError
from orbitfb.core.signals import Applied, Channels, Mask, Reading, Vector
from orbitfb.loop.lending.lent import Ask, Leave, LentMachine, Loan, Read, Request, Write
from orbitfb.loop.lending.turn import Turn

SPEECHLESS = 10.0
"""Without a call for so long [s] a borrower is given up by a loop that ends: it computes for a
second at most, and a disk that takes longer to write a file does not work."""

Given = Reading | NoOrbitError
"""What a tick has for the borrower: an orbit, or why there is none."""
_T = TypeVar("_T")


class Carrier(Protocol):
    """Carries out in the loop's thread what a borrower asks for."""

    def setpoints(self) -> Vector:
        """Ask the machine for the setpoints in force, shape (m,) [A]."""
        ...

    def write(self, setpoints: Vector, which: Mask) -> Applied:
        """Send setpoints of some correctors, if every limit holds."""
        ...


class Lending:
    """Lends the machine to one borrower at a time.

    Args:
        channels: Of the machine.
        turn: Whose turn it is to move setpoints.
        patience: How long a tick waits for a borrower that computes [s].
    """

    def __init__(self, channels: Channels, turn: Turn, patience: float) -> None:
        self._channels, self._turn, self._patience = channels, turn, patience
        self.loan: Loan | None = None

    @property
    def busy(self) -> bool:
        """Whether the machine is lent."""
        return self.loan is not None

    @property
    def under_way(self) -> str:
        """What it is lent for, in words; empty: it is not lent."""
        loan = self.loan
        return f"{loan.name} is under way; abort it first" if loan else ""

    def lend(self, name: str, correctors: Mask) -> LentMachine:
        """Lend the machine; called in the borrower's thread.

        Args:
            name: What for.
            correctors: Those that may be written, shape (m,).

        Raises:
            ControlError: Setpoints are being moved, or the loop has ended.
        """
        self._turn.take(name)
        loan = Loan(name, correctors.copy())
        self.loan = loan
        return LentMachine(self._channels, loan)

    def serve(self, given: Given, carrier: Carrier) -> None:
        """Answer the borrower until it waits for the next orbit; called in the loop's thread.

        Args:
            given: What this tick has for it.
            carrier: Talks to the machine.
        """
        loan = self.loan
        if loan is None:
            return
        if loan.waiting is not None:
            request, loan.waiting = loan.waiting, None
            _answer(request.answer, partial(_orbit, loan, given))
        put = np.zeros(len(loan.lent), dtype=np.bool_)
        while (request := self._next(loan)) is not None:
            match request:
                case Read():
                    loan.waiting = request
                    return
                case Ask():
                    _answer(request.answer, carrier.setpoints)
                case Write() as write if (put & write.which).any():
                    loan.deferred = write
                    return
                case Write() as write:
                    put |= write.which
                    _answer(write.answer, partial(_written, loan, write, carrier))
                case Leave():
                    self._end()
                    request.answer.set_result(None)
                    return

    def end(self, reason: str, serve: Callable[[], None], now: Callable[[], float]) -> None:
        """Call the machine back and serve until the borrower has put back what it moved.

        Args:
            reason: Why the loop ends.
            serve: Serves it once, with an orbit of its own.
            now: Monotonic clock [s].
        """
        begin, calls = now(), -1
        while (loan := self.loan) is not None:
            loan.call_back(reason)
            serve()
            if loan.calls != calls:
                begin, calls = now(), loan.calls
            elif now() - begin > SPEECHLESS and self.loan is loan:  # it does not come to an end
                self._end()
                loan.refuse()

    def _end(self) -> None:
        if self.loan is not None:
            self.loan.over, self.loan = True, None
        self._turn.leave()

    def _next(self, loan: Loan) -> Request | None:
        request: Request | None = loan.deferred
        loan.deferred = None
        if request is not None:
            return request
        try:
            request = loan.requests.get(timeout=self._patience)
        except Empty:  # it computes, or writes a file; the loop has to go on
            return None
        loan.calls += 1
        return request


def _orbit(loan: Loan, given: Given) -> Reading:
    if (error := loan.tell()) is not None:
        raise error
    if isinstance(given, NoOrbitError):
        raise given
    return given


def _written(loan: Loan, request: Write, carrier: Carrier) -> Applied:
    if (error := loan.tell()) is not None:
        raise error
    if (request.which & ~loan.lent).any():
        raise WriteError(f"correctors that are not lent for the {loan.name}; nothing was sent")
    return carrier.write(request.setpoints, request.which)


def _answer(future: Future[_T], work: Callable[[], _T]) -> None:
    try:
        future.set_result(work())
    except Exception as error:  # whatever it is, it is the borrower's
        future.set_exception(error)

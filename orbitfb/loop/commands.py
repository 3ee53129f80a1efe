"""Commands on their way to the loop: given in any thread, effective between two ticks."""

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Protocol

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.lending.desk import Lending
from orbitfb.loop.memory import LoopMemory
from orbitfb.loop.states import Event, as_command, next_state
from orbitfb.safety.verdict import Verdict

Order = tuple[Event, Future[LoopState]]
"""A command and where its outcome goes."""


ORBIT_TO_CLOSE_ON = 2.0
"""How long an order to close waits for an orbit before it is refused for want of one [s]."""


class ClosingOrders:
    """Orders to close, which wait until the interlocks have looked at an orbit.

    Args:
        now: Monotonic clock [s].
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now, self._until = now, -math.inf
        self._orders: list[Order] = []

    def __bool__(self) -> bool:
        """Whether the loop is asked to close."""
        return bool(self._orders)

    @property
    def overdue(self) -> bool:
        """Whether no orbit came in time."""
        return self._now() >= self._until

    def wait(self, order: Order) -> None:
        """Let one more wait for the next orbit."""
        self._orders.append(order)
        self._until = self._now() + ORBIT_TO_CLOSE_ON

    def done(self, state: LoopState) -> None:
        """Answer all with the state of the loop."""
        orders, self._orders = self._orders, []
        for _, future in orders:
            future.set_result(state)

    def refuse(self, reason: str) -> None:
        """Refuse all."""
        orders, self._orders = self._orders, []
        for event, future in orders:
            future.set_exception(ControlError(f"{event} refused: {reason}"))


class CommandQueue:
    """Commands that the loop has not taken yet."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._orders: list[Order] = []
        self._ended = ""

    def put(self, event: Event) -> Future[LoopState]:
        """Queue a command.

        Returns:
            Its outcome: the state of the loop after it, or a `ControlError`.

        Raises:
            ControlError: The loop has ended and takes no commands.
        """
        future: Future[LoopState] = Future()
        with self._lock:
            if self._ended:
                raise ControlError(f"{event} refused: {self._ended}")
            self._orders.append((event, future))
        return future

    def take(self) -> list[Order]:
        """Take all commands that were not cancelled, oldest first."""
        if not self._orders:
            return []
        with self._lock:
            orders, self._orders = self._orders, []
        return [order for order in orders if order[1].set_running_or_notify_cancel()]

    def end(self, reason: str) -> None:
        """Refuse what is queued and whatever comes later."""
        with self._lock:
            self._ended = reason
        for event, future in self.take():
            future.set_exception(ControlError(f"{event} refused: {reason}"))


class Movable(Protocol):
    """What commands move from state to state."""

    memory: LoopMemory

    @property
    def lending(self) -> Lending:
        """Whether the machine is lent."""
        ...

    def move(self, event: Event, reason: str) -> None:
        """Go where the state table says."""
        ...


class Commands:
    """Carries out commands between two ticks, and closes once the interlocks agree.

    Args:
        loop: What is commanded.
        now: Monotonic clock [s].

    Attributes:
        closing: Orders to close that wait for an orbit.
    """

    def __init__(self, loop: Movable, now: Callable[[], float]) -> None:
        self._loop = loop
        self._queue = CommandQueue()
        self.closing = ClosingOrders(now)

    def give(self, name: str) -> Future[LoopState]:
        """Queue a command; may be called from any thread.

        Args:
            name: `open`, `shadow`, `close` or `reset`.

        Returns:
            Its outcome: the state after it, or a `ControlError` with what refused it.

        Raises:
            ControlError: No such command, not legal in the present state, or the loop ended.
        """
        event = as_command(name)
        self._after(event)
        return self._queue.put(event)

    def obey(self) -> None:
        """Carry out the commands that came; those to close wait for the interlocks."""
        for event, future in self._queue.take():
            try:
                after = self._after(event)
                if after is LoopState.CLOSED and after is not self._state:
                    self.closing.wait((event, future))
                    continue
                self._loop.move(event, "")
            except ControlError as error:
                future.set_exception(error)
            else:
                future.set_result(self._state)
                self.closing.refuse(f"the command {event} came right after it")

    def close(self, verdict: Verdict) -> None:
        """Close if that is ordered and the interlocks agree.

        Args:
            verdict: What they say of the orbit.
        """
        if not self.closing:
            return
        lent = self._loop.lending.under_way
        if lent or not verdict.may_act:
            self.closing.refuse(lent or verdict.reason)
            return
        self._loop.move(Event.CLOSE, "")
        self.closing.done(self._state)

    def end(self, reason: str) -> None:
        """Refuse what is queued and whatever comes later."""
        self._queue.end(reason)

    @property
    def _state(self) -> LoopState:
        return self._loop.memory.state

    def _after(self, event: Event) -> LoopState:
        """Look up the state after a command; a loop whose machine is lent stays open."""
        after = next_state(self._state, event)
        if after is not LoopState.OPEN and (lent := self._loop.lending.under_way):
            raise ControlError(f"{event} refused: {lent}")
        return after

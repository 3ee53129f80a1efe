"""Commands on their way to the loop: given in any thread, effective between two ticks."""

import math
import threading
from collections.abc import Callable
from concurrent.futures import Future

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.states import Event

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

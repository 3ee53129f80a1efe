"""Commands on their way to the loop: given in any thread, effective between two ticks."""

import threading
from concurrent.futures import Future

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.states import Event

Order = tuple[Event, Future[LoopState]]
"""A command and where its outcome goes."""


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

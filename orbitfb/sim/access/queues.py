"""Queues of one client of the fast front, where those of caproto would let others wait."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import caproto as ca


class DroppingQueue(asyncio.Queue[Any]):
    """A bounded queue that refuses instead of waiting.

    caproto waits for room in a slow client's queue and with it lets every other client wait;
    what it does on QueueFull, which this raises, is to clear the queue of that client.
    """

    async def put(self, item: Any) -> None:
        """Put at once, or raise QueueFull."""
        self.put_nowait(item)

    def clear(self) -> None:
        """Forget everything."""
        while not self.empty():
            self.get_nowait()


class Commands(asyncio.Queue[Any]):
    """A client's commands on their way to caproto, which asks for one when the last one is done.

    Args:
        keep: Says whether a command is carried out without caproto.
        done: Told of one that caproto has carried out; its writes may be under way still.
    """

    def __init__(self, keep: Callable[[Any], Awaitable[bool]], done: Callable[[Any], None]) -> None:
        super().__init__(ca.MAX_COMMAND_BACKLOG)
        self._keep, self._done = keep, done
        self._last: Any = None

    async def get(self) -> Any:
        """Give the next one that is for caproto."""
        if self._last is not None:
            self._done(self._last)
            self._last = None
        command = await super().get()
        while await self._keep(command):
            command = await super().get()
        self._last = command
        return command

"""Count the writes of a client that caproto is carrying out."""

import asyncio

from caproto.asyncio.server import AsyncioEvent


class WritesUnderWay(AsyncioEvent):
    """A circuit's `write_event`: caproto clears it as a write begins and sets it as one ends.

    Attributes:
        count: Writes that have begun and have not ended.
    """

    def __init__(self) -> None:
        super().__init__()
        self.count = 0
        self._fewer = asyncio.Event()

    def clear(self) -> None:
        """A write begins."""
        self.count += 1
        super().clear()

    def set(self) -> None:
        """A write has ended; the first call says that there is none yet."""
        self.count = max(self.count - 1, 0)
        self._fewer.set()
        super().set()

    async def below(self, most: int) -> None:
        """Wait until there are fewer."""
        while self.count >= most:
            self._fewer.clear()
            await self._fewer.wait()

"""Says once what is to know of the servers of the PVs: doubled ones, and moves between them."""

from collections.abc import Callable

from orbitfb.core.signals import TickRecord


class ServerNews:
    """A subscriber of the loop.

    Args:
        doubled: Says which PVs are on several servers; empty as long as none was seen.
        tell: Gets what is new, in words.
    """

    def __init__(self, doubled: Callable[[], str], tell: Callable[[str], None]) -> None:
        self._doubled, self._tell = doubled, tell
        self._moves, self._told = 0, False

    def __call__(self, record: TickRecord) -> None:
        """Look at a tick."""
        reading = record.reading
        if reading is not None and reading.moves > self._moves:
            self._moves = reading.moves
            self._tell(reading.moved)
        if not self._told and (text := self._doubled()):
            self._told = True
            self._tell(text)

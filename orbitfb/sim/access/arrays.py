"""Channels that hold a whole vector, of which the board has the values."""

from typing import Any

import numpy as np
from caproto import AccessRights, CaprotoValueError, ChannelDouble, ChannelType, TimeStamp
from numpy.typing import NDArray

from orbitfb.sim.access.board import Board
from orbitfb.sim.access.channels import BACKLOG, Watcher
from orbitfb.sim.layout import PvSpec


class BoardArray(ChannelDouble):
    """A reading of many devices.

    It has the stamp of the first, and no alarm: an element that must not be used is NaN.

    Args:
        name: Of the PV.
        spec: Of one element; all are alike.
        board: Has the values.
        places: Indices on the board, in the order of the elements, shape (k,).
        watcher: Told of subscriptions that the feeds do not serve.
    """

    def __init__(
        self, name: str, spec: PvSpec, board: Board, places: NDArray[np.intp], watcher: Watcher
    ) -> None:
        super().__init__(
            value=[0.0] * len(places),
            units=spec.units,
            precision=spec.precision,
            lower_disp_limit=spec.display[0],
            upper_disp_limit=spec.display[1],
            lower_ctrl_limit=spec.drive[0],
            upper_ctrl_limit=spec.drive[1],
            max_subscription_backlog=BACKLOG,
        )
        self.pv, self.places = name, places
        self._board, self._watcher = board, watcher
        self._kinds: set[Any] = set()
        self._quiet = False

    def get_field(self, field: str) -> "BoardArray":
        """Give the field of the record; there is only the value."""
        if field != "VAL":
            raise KeyError(field)
        return self

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read and nobody write."""
        return AccessRights.READ

    async def pull(self, events: int | None = None) -> None:
        """Take values and stamp from the board.

        Args:
            events: Kinds of subscriptions that are told of it; None: none.
        """
        self._quiet = events is None
        try:
            await ChannelDouble.write(
                self,
                self._board.value[self.places].tolist(),
                flags=events or 0,
                verify_value=False,
                timestamp=TimeStamp(*self._board.get(int(self.places[0])).stamp),
            )
        finally:
            self._quiet = False

    async def publish(self, flags: Any) -> None:
        """Tell subscriptions; of what was only looked up there is nothing to tell."""
        if not (self._quiet and self._kinds):
            await super().publish(flags)

    async def read(self, data_type: Any) -> Any:
        """Give what is on the board as any type."""
        await self.pull()
        return await super().read(data_type)

    async def subscribe(self, queue: Any, sub_spec: Any, sub: Any) -> None:
        """Let caproto serve a subscription that the feeds do not."""
        await self.pull()
        self._kinds.add(sub_spec)
        self._watcher.watch(self, True)
        await super().subscribe(queue, sub_spec, sub)

    async def unsubscribe(self, queue: Any, sub_spec: Any) -> None:
        """End what `subscribe` began."""
        await super().unsubscribe(queue, sub_spec)
        self._kinds.discard(sub_spec)
        if not self._kinds:
            self._watcher.watch(self, False)


class BoardArraySetpoint(BoardArray):
    """Setpoints of many devices, when they are written in any but the fast way."""

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read and write."""
        return AccessRights.READ | AccessRights.WRITE

    async def auth_write(
        self,
        hostname: str,
        username: str,
        data: Any,
        data_type: Any,
        metadata: Any,
        **options: Any,
    ) -> Any:
        """Take plain values alone: with limits in it, a write would set them."""
        if data_type > ChannelType.DOUBLE:
            raise CaprotoValueError(f"takes plain values only, not {data_type!r}")
        return await super().auth_write(hostname, username, data, data_type, metadata, **options)

    async def write(self, value: Any, **options: Any) -> None:
        """Take all values, or none."""
        values = np.atleast_1d(np.asarray(value, dtype=np.float64))
        which = self.places - self._board.readings
        if values.shape != which.shape or not self._board.allowed(which, values).all():
            raise CaprotoValueError(
                f"{self.pv} takes {len(which)} finite values within the drive limits"
            )
        self._watcher.put(which, values)
        await self.pull()

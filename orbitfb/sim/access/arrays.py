"""Channels that hold a whole vector, of which the board has the values."""

from typing import Any

import numpy as np
from caproto import AccessRights, CaprotoValueError, ChannelDouble, ChannelType, TimeStamp
from numpy.typing import NDArray

from orbitfb.sim.access.board import Board
from orbitfb.sim.access.channels import BACKLOG, OnBoard, Watcher
from orbitfb.sim.layout import PvSpec


class BoardArray(OnBoard):
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
        self._stand(name, places, board, watcher)

    def get_field(self, field: str) -> "BoardArray":
        """Give the field of the record; there is only the value."""
        if field != "VAL":
            raise KeyError(field)
        return self

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read and nobody write."""
        return AccessRights.READ

    async def _take(self, flags: int) -> None:
        await ChannelDouble.write(
            self,
            self._board.value[self.places].tolist(),
            flags=flags,
            verify_value=False,
            timestamp=TimeStamp(*self._board.get(int(self.places[0])).stamp),
        )


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

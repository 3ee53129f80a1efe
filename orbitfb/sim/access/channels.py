"""The PVs as caproto knows them, and those whose truth is on the board."""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
from caproto import (
    AccessRights,
    AlarmSeverity,
    AlarmStatus,
    CaprotoValueError,
    ChannelAlarm,
    ChannelDouble,
    ChannelString,
    ChannelType,
    TimeStamp,
)
from numpy.typing import NDArray

from orbitfb.core.names import LEASE_PV
from orbitfb.core.signals import Vector
from orbitfb.sim.access.board import Board, Entry
from orbitfb.sim.access.stamp import Stamp
from orbitfb.sim.layout import Layout, PvSpec


class ScalarChannel(ChannelDouble):
    """A double with units and limits, and with an alarm of its own."""

    def __init__(self, spec: PvSpec, value: float = 0.0, backlog: int | None = None) -> None:
        limits = {
            f"{end}_{name}_limit": limit
            for name, ends in (
                ("disp", spec.display),
                ("warning", spec.warning),
                ("alarm", spec.alarm),
                ("ctrl", spec.drive),
            )
            for end, limit in zip(("lower", "upper"), ends, strict=True)
        }
        if backlog is not None:
            limits["max_subscription_backlog"] = backlog
        self._own_alarm = ChannelAlarm()
        super().__init__(
            value=value,
            units=spec.units,
            precision=spec.precision,
            alarm=self._own_alarm,
            **limits,
        )

    async def auth_write(
        self,
        hostname: str,
        username: str,
        data: Any,
        data_type: Any,
        metadata: Any,
        **options: Any,
    ) -> Any:
        """Take plain values alone, as an IOC does: with limits in it, a write would set them."""
        if data_type > ChannelType.DOUBLE:
            raise CaprotoValueError(f"takes plain values only, not {data_type!r}")
        return await super().auth_write(hostname, username, data, data_type, metadata, **options)

    def get_field(self, field: str) -> "ScalarChannel":
        """Give the field of the record; there is only the value."""
        if field != "VAL":
            raise KeyError(field)
        return self


class ReadOnlyChannel(ScalarChannel):
    """A reading, which nobody writes."""

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read and nobody write."""
        return AccessRights.READ


class KnobChannel(ScalarChannel):
    """A PV whose write does something to the simulated ring.

    Args:
        spec: The PV.
        turned: Called with what was written, in the PV's units.
    """

    def __init__(self, spec: PvSpec, turned: Callable[[float], None]) -> None:
        super().__init__(spec, spec.initial)
        self._turned = turned

    async def write(self, value: Any, **options: Any) -> None:
        """Take the value and act on it; a value that is refused does nothing."""
        await super().write(value, **options)
        self._turned(float(self.value))


def knob_channels(layout: Layout, turned: Callable[[str, float], None]) -> dict[str, KnobChannel]:
    """Make the channels of all knobs, by name.

    Args:
        layout: Has the knobs.
        turned: Called with the PV and what was written to it, in its units.
    """
    return {spec.name: KnobChannel(spec, partial(turned, spec.name)) for spec in layout.knobs}


class TextChannel(ChannelString):
    """A text that anybody may write, up to 39 characters."""

    def __init__(self) -> None:
        super().__init__(value="", string_encoding="latin-1")

    def get_field(self, field: str) -> "TextChannel":
        """Give the field of the record; there is only the value."""
        if field != "VAL":
            raise KeyError(field)
        return self


def lease_channels(planes: str) -> dict[str, TextChannel]:
    """Make the texts that say which controller writes to each plane, by name."""
    return {LEASE_PV.replace("%", plane.upper()): TextChannel() for plane in planes}


class Watched(Protocol):
    """A channel of the board."""

    @property
    def places(self) -> NDArray[np.intp]:
        """Indices on the board of its values, shape (k,)."""
        ...

    async def pull(self, events: int | None = None) -> None:
        """Take values and stamp from the board, and tell subscriptions of these kinds."""
        ...


class Watcher(Protocol):
    """Who is told what happens to the channels of a board."""

    def watch(self, channel: Watched, watched: bool) -> None:
        """Learn whether caproto itself has to be told of this channel's updates."""
        ...

    def put(self, which: NDArray[np.intp], values: Vector) -> None:
        """Put setpoints in force that are within their limits, and tell all clients."""
        ...

    def changed(self, index: int, accepted: bool) -> None:
        """Learn that a setpoint was written, or refused, through caproto."""
        ...


BACKLOG = 4
"""Updates that caproto keeps for one slow subscription."""


class OnBoard(ChannelDouble):
    """A channel that takes its state from the board when caproto asks for it.

    The usual monitors are served by the feeds. Reads and all other kinds of subscription go
    caproto's way.

    Attributes:
        pv: Its name.
        places: Indices of its values on the board, shape (k,).
    """

    pv: str
    places: NDArray[np.intp]

    def _stand(self, name: str, places: NDArray[np.intp], board: Board, watcher: Watcher) -> None:
        """Note where its values are, and who is told of subscriptions that feeds do not serve."""
        self.pv, self.places = name, places
        self._board, self._watcher = board, watcher
        self._kinds: set[Any] = set()
        self._quiet = False

    async def _take(self, flags: int) -> None:
        """Take the state from the board.

        Args:
            flags: Kinds of subscriptions (`SubscriptionType`) that are told of it.
        """
        raise NotImplementedError

    async def pull(self, events: int | None = None) -> None:
        """Take the state from the board.

        Args:
            events: Kinds of subscriptions (`SubscriptionType`) that are told of it; None: none.
        """
        self._quiet = events is None
        try:
            await self._take(events or 0)
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


class BoardChannel(OnBoard, ScalarChannel):
    """A channel whose value, stamp and alarm are on the board."""

    def __init__(self, spec: PvSpec, board: Board, index: int, watcher: Watcher) -> None:
        super().__init__(spec, backlog=BACKLOG)
        self.index = index
        self._stand(spec.name, np.array([index]), board, watcher)

    async def _take(self, flags: int) -> None:
        entry = self._board.get(self.index)
        await ScalarChannel.write(
            self,
            entry.value,
            flags=flags,
            verify_value=False,
            timestamp=TimeStamp(*entry.stamp),
            status=AlarmStatus(entry.status),
            severity=AlarmSeverity(entry.severity),
        )


class BoardReading(BoardChannel):
    """A reading on the board, which nobody writes."""

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read and nobody write."""
        return AccessRights.READ


class BoardSetpoint(BoardChannel):
    """A setpoint on the board, when it is written in any but the fast way."""

    async def write(self, value: Any, **options: Any) -> None:
        """Take the value, or refuse it and raise the alarm; the board has either."""
        await self.pull()
        accepted = False
        try:
            await super().write(value, **options)
            accepted = True
        finally:
            self._push()
            self._watcher.changed(self.index, accepted)

    def _push(self) -> None:
        seconds, nanoseconds = self.epics_timestamp
        self._board.set(
            self.index,
            Entry(
                float(self.value),
                Stamp(seconds, nanoseconds),
                int(self._own_alarm.status),
                int(self._own_alarm.severity),
            ),
        )

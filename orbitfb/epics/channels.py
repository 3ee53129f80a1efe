"""Channels of one kind: who is connected, who may be written, and searching anew for the rest."""

import ctypes
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.epics.libca import (
    ACCESS_HANDLER,
    CONNECTION_HANDLER,
    DBR_DOUBLE,
    DBR_FLOAT,
    DBR_TIME_DOUBLE,
    ECA_NORMAL,
    EVENT_HANDLER,
    MONITOR_VALUE_AND_ALARM,
    OPERATION_UP,
    WRITE_ACCESS,
    AccessArguments,
    ConnectionArguments,
    Context,
    EventArguments,
    keep_thread_state,
    move_memory,
)
from orbitfb.epics.records import RECORD

FIELD_TYPES = {0: "text", 1: "a short integer", 3: "an enumeration", 4: "bytes", 5: "an integer"}
"""Native types that hold no real number, by their number in db_access.h."""
REAL, WHOLE = (DBR_FLOAT, DBR_DOUBLE), (1, 5)
"""Native types that hold real numbers, and whole ones. An int64 is a real number to Channel
Access: that its record rounds is not to be seen there."""

ChangeHandler = Callable[[int, bool], None]


@dataclass(frozen=True, slots=True)
class Monitor:
    """What to do with the events of a group.

    Args:
        records: One record per channel, written in place.
        arrived: Called after each event; True when a vector has become complete. None: not counted.
        complete: Called when `arrived` said so, before the next event is written.
        heard: Called with the channel's index after each event; None: nobody.
    """

    records: NDArray[np.void]
    arrived: Callable[[], bool] | None = None
    complete: Callable[[], None] | None = None
    heard: Callable[[int], None] | None = None


class ChannelGroup:
    """Channels of one kind, in the order of their names.

    Handlers run on libca's threads, one at a time per context. `lock` is held while channels are
    created anew: whoever uses `handles` from another thread must hold it.

    Args:
        context: Where they live; the thread that calls `open` and `reopen_away` is attached to it.
        names: The PVs.
        monitor: What to do with their events; None: no subscription.
        changed: Called with index and state when a channel has come or gone.
    """

    def __init__(
        self,
        context: Context,
        names: Sequence[str],
        monitor: Monitor | None = None,
        changed: ChangeHandler | None = None,
    ) -> None:
        size = len(names)
        self.names = tuple(names)
        self.connected: Mask = np.zeros(size, dtype=np.bool_)
        self.writable: Mask = np.zeros(size, dtype=np.bool_)
        self.handles = (ctypes.c_void_p * size)()
        self.generation = 0
        """Grows when handles have changed."""
        self.servers = [""] * size
        """Where each channel was connected to last, `host:port`."""
        self.arrivals = 0
        """How often a channel came."""
        self.losses = 0
        """How often a channel went away."""
        self.lock = threading.Lock()
        self._context = context
        self._library = context.library
        self._monitor = monitor
        self._changed = changed
        # libca keeps the addresses of these: they must live as long as the context.
        self._connection_handler = CONNECTION_HANDLER(self._on_connection)
        self._access_handler = ACCESS_HANDLER(self._on_access)
        self._event_handler = (
            EVENT_HANDLER() if monitor is None else EVENT_HANDLER(_event_handler(monitor))
        )

    def __len__(self) -> int:
        return len(self.names)

    @property
    def all_connected(self) -> bool:
        """Whether every channel is connected."""
        return bool(self.connected.all())

    @property
    def disconnected(self) -> tuple[str, ...]:
        """The PVs that are away."""
        return self._names_where(~self.connected)

    @property
    def read_only(self) -> tuple[str, ...]:
        """The PVs that are connected and may not be written."""
        return self._names_where(self.connected & ~self.writable)

    @property
    def not_real(self) -> tuple[str, ...]:
        """The PVs that are connected and hold no real number, each with what it holds."""
        return self._told_of_other(REAL)

    @property
    def not_numbers(self) -> tuple[str, ...]:
        """The PVs that are connected and hold no number, each with what it holds."""
        return self._told_of_other((*REAL, *WHOLE))

    @property
    def whole(self) -> Mask:
        """PVs that are connected and hold whole numbers only, shape (k,)."""
        mask = np.zeros(len(self), dtype=np.bool_)
        mask[[index for index, kind in self._kinds().items() if kind in WHOLE]] = True
        return mask

    def _told_of_other(self, kinds: tuple[int, ...]) -> tuple[str, ...]:
        return tuple(
            f"{self.names[index]} is {FIELD_TYPES.get(kind, f'of type {kind}')}"
            for index, kind in self._kinds().items()
            if kind not in kinds
        )

    def _kinds(self) -> dict[int, int]:
        """Native types of those that are connected, by index."""
        with self.lock:
            return {
                index: int(self._library.ca_field_type(self.handles[index]))
                for index in np.flatnonzero(self.connected).tolist()
            }

    def open(self) -> None:
        """Create all channels and start to search for them."""
        with self.lock:
            for index in range(len(self)):
                self._create(index)
            self.generation += 1
        self._context.flush()

    def reopen_away(self) -> int:
        """Clear and create anew the channels that are away.

        libca searches for a lost channel at intervals that grow to 18 s; for a new one it starts
        again at 30 ms.

        Returns:
            How many there were.
        """
        away = np.flatnonzero(~self.connected)
        if not away.size:
            return 0
        with self.lock:
            for index in away.tolist():
                self._library.ca_clear_channel(self.handles[index])
                if self.connected[index]:  # came back by itself just now
                    self._set_connected(index, False)
                self._create(index)
            self.generation += 1
        self._context.flush()
        return int(away.size)

    def forget(self) -> None:
        """Take no request any more: the context is about to end."""
        with self.lock:
            self.connected[:] = False

    def _create(self, index: int) -> None:
        library = self._library
        handle = ctypes.c_void_p()
        # The handler may be called before the handle is known here: the user word says who it is.
        status = library.ca_create_channel(
            self.names[index].encode(),
            ctypes.cast(self._connection_handler, ctypes.c_void_p),
            index + 1,
            0,
            ctypes.byref(handle),
        )
        self._context.check(f"creating the channel {self.names[index]}", status)
        self.handles[index] = handle.value
        status = library.ca_replace_access_rights_event(
            handle, ctypes.cast(self._access_handler, ctypes.c_void_p)
        )
        self._context.check(f"asking for the access rights of {self.names[index]}", status)
        if self._monitor is not None:
            status = library.ca_create_subscription(
                DBR_TIME_DOUBLE,
                1,
                handle,
                MONITOR_VALUE_AND_ALARM,
                ctypes.cast(self._event_handler, ctypes.c_void_p),
                self._monitor.records.ctypes.data + index * RECORD.itemsize,
                None,
            )
            self._context.check(f"subscribing to {self.names[index]}", status)

    def _on_connection(self, arguments: ConnectionArguments) -> None:
        up = arguments.operation == OPERATION_UP
        index = self._library.ca_puser(arguments.channel) - 1
        if up:
            keep_thread_state()
            # A circuit that answers again after a silence brings its channels back without an
            # access event, though it took their rights away by one.
            self.writable[index] = bool(self._library.ca_write_access(arguments.channel))
            self.servers[index] = self._context.host_of(arguments.channel)
            self.arrivals += 1
        self._set_connected(index, up)

    def _on_access(self, arguments: AccessArguments) -> None:
        index = self._library.ca_puser(arguments.channel) - 1
        self.writable[index] = bool(arguments.rights & WRITE_ACCESS)

    def _set_connected(self, index: int, up: bool) -> None:
        self.losses += bool(self.connected[index]) and not up
        self.connected[index] = up
        if self._changed is not None:
            self._changed(index, up)

    def _names_where(self, mask: Mask) -> tuple[str, ...]:
        return tuple(self.names[index] for index in np.flatnonzero(mask))


def _event_handler(monitor: Monitor) -> Callable[[EventArguments], None]:
    """Return the handler of events: it runs once per scalar, so it does next to nothing."""
    size, arrived, complete = RECORD.itemsize, monitor.arrived, monitor.complete
    move = move_memory

    def keep(arguments: EventArguments) -> None:
        if arguments.status == ECA_NORMAL:
            move(arguments.user, arguments.data, size)

    if (heard := monitor.heard) is not None:
        begin = monitor.records.ctypes.data

        def keep_and_tell(arguments: EventArguments) -> None:
            if arguments.status == ECA_NORMAL:
                move(arguments.user, arguments.data, size)
                heard((arguments.user - begin) // size)

        return keep_and_tell

    if arrived is None or complete is None:
        return keep

    def keep_and_count(arguments: EventArguments) -> None:
        if arguments.status == ECA_NORMAL:
            move(arguments.user, arguments.data, size)
            if arrived():
                complete()

    return keep_and_count

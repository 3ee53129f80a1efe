"""Channels of one kind: who is connected, who may be written, and searching anew for the rest."""

import ctypes
import threading
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.names import NamedPv, named_pvs
from orbitfb.core.signals import Mask
from orbitfb.epics.events import Monitor, array_handler, scalar_handler
from orbitfb.epics.libca import (
    ACCESS_HANDLER,
    CONNECTION_HANDLER,
    DBR_CTRL_DOUBLE,
    DBR_DOUBLE,
    DBR_FLOAT,
    DBR_TIME_DOUBLE,
    ECA_NORMAL,
    EVENT_HANDLER,
    MONITOR_PROPERTY,
    MONITOR_VALUE_AND_ALARM,
    OPERATION_UP,
    WRITE_ACCESS,
    AccessArguments,
    ConnectionArguments,
    Context,
    EventArguments,
    keep_thread_state,
)
from orbitfb.epics.records import RECORD
from orbitfb.epics.statements import Statements

FIELD_TYPES = {0: "text", 1: "a short integer", 3: "an enumeration", 4: "bytes", 5: "an integer"}
"""Native types that hold no real number, by their number in db_access.h."""
REAL, WHOLE = (DBR_FLOAT, DBR_DOUBLE), (1, 5)
"""Native types that hold real numbers, and whole ones. An int64 is a real number to Channel
Access: that its record rounds is not to be seen there."""

NOT_HEARD = -1
"""Length of an array that has had no event."""

ChangeHandler = Callable[[int, bool], None]


class ChannelGroup:
    """Channels of one kind, in the order of their names.

    A name is a PV, or an element of an array (`core.names`): then it shares a channel with all
    other elements of that array. `connected` and `writable` are by name, what belongs to a channel
    is by PV.

    Handlers run on libca's threads, one at a time per context. `lock` is held while channels are
    created anew: whoever uses `handles` from another thread must hold it.

    Args:
        context: Where they live; the thread that calls `open` and `reopen_away` is attached to it.
        names: PVs, or elements of arrays.
        monitor: What to do with their events; None: no subscription.
        changed: Called with the place of each name and its state when its channel has come or gone.
        properties: Whether to be told when units or limits change.
    """

    def __init__(
        self,
        context: Context,
        names: Sequence[str],
        monitor: Monitor | None = None,
        changed: ChangeHandler | None = None,
        properties: bool = False,
    ) -> None:
        size = len(names)
        self.names = tuple(names)
        self.connected: Mask = np.zeros(size, dtype=np.bool_)
        self.writable: Mask = np.zeros(size, dtype=np.bool_)
        self.pvs: tuple[NamedPv, ...] = named_pvs(self.names)
        """The channels."""
        self._first = np.array([pv.places[0] for pv in self.pvs], dtype=np.intp)
        self.handles = (ctypes.c_void_p * len(self.pvs))()
        self.lengths: NDArray[np.int64] = np.full(len(self.pvs), NOT_HEARD, dtype=np.int64)
        """Values of each array at its last event."""
        self.generation = 0
        """Grows when handles have changed."""
        self.servers = [""] * len(self.pvs)
        """Where each channel was connected to last, `host:port`."""
        self.arrivals = 0
        """How often a channel came."""
        self.losses = 0
        """How often a channel went away."""
        self.restated = 0
        """How often a PV has stated another unit or other limits."""
        self.lock = threading.Lock()
        self._context = context
        self._library = context.library
        self._monitor = monitor
        self._changed, self._properties = changed, properties
        self._statements = Statements(len(self.pvs))
        self._property_events = (ctypes.c_void_p * len(self.pvs))()
        # libca keeps the addresses of these: they must live as long as the context.
        self._connection_handler = CONNECTION_HANDLER(self._on_connection)
        self._access_handler = ACCESS_HANDLER(self._on_access)
        self._property_handler = EVENT_HANDLER(self._on_property)
        if monitor is not None:
            self._scalar_handler = EVENT_HANDLER(scalar_handler(monitor))
            self._array_handler = EVENT_HANDLER(array_handler(monitor, self.pvs, self.lengths))

    def __len__(self) -> int:
        return len(self.names)

    @property
    def all_connected(self) -> bool:
        """Whether every channel is connected."""
        return bool(self.connected.all())

    @property
    def present(self) -> list[int]:
        """Numbers of the PVs that are connected."""
        return np.flatnonzero(self.connected[self._first]).tolist()

    @property
    def disconnected(self) -> tuple[str, ...]:
        """The PVs that are away."""
        return self._pvs_where(~self.connected)

    @property
    def read_only(self) -> tuple[str, ...]:
        """The PVs that are connected and may not be written."""
        return self._pvs_where(self.connected & ~self.writable)

    @property
    def not_real(self) -> tuple[str, ...]:
        """The PVs that are connected and hold no real number, each with what it holds."""
        return self._told_of_other(REAL)

    @property
    def not_numbers(self) -> tuple[str, ...]:
        """The PVs that are connected and hold no number, each with what it holds."""
        return self._told_of_other((*REAL, *WHOLE))

    @property
    def too_short(self) -> tuple[str, ...]:
        """The arrays that are connected and hold fewer values than are named, each with both."""
        return tuple(
            f"{self.pvs[number].name} holds {size} values, and element "
            f"{self.pvs[number].length - 1} is named"
            for number, size in self._ask_each(self._library.ca_element_count).items()
            if size < self.pvs[number].length
        )

    @property
    def unheard(self) -> bool:
        """Whether an array is connected and has not told its values yet."""
        return self._monitor is not None and any(
            self.lengths[number] == NOT_HEARD
            for number in self.present
            if self.pvs[number].elements is not None
        )

    @property
    def not_whole(self) -> tuple[str, ...]:
        """The arrays that are connected and hold values without a name, each with how many."""
        return tuple(
            f"{self.pvs[number].name} holds {size} values, of which {len(pv.places)} are named"
            for number, size in self._ask_each(self._library.ca_element_count).items()
            if (pv := self.pvs[number]).elements is not None and size != len(pv.places)
        )

    @property
    def whole(self) -> Mask:
        """Names whose PV is connected and holds whole numbers only, shape (k,)."""
        mask = np.zeros(len(self), dtype=np.bool_)
        for number, kind in self._kinds().items():
            mask[self.pvs[number].places] = kind in WHOLE
        return mask

    def _told_of_other(self, kinds: tuple[int, ...]) -> tuple[str, ...]:
        return tuple(
            f"{self.pvs[number].name} is {FIELD_TYPES.get(kind, f'of type {kind}')}"
            for number, kind in self._kinds().items()
            if kind not in kinds
        )

    def _kinds(self) -> dict[int, int]:
        """Native types of those that are connected, by number of the PV."""
        return self._ask_each(self._library.ca_field_type)

    def _ask_each(self, what: Callable[[int | None], int]) -> dict[int, int]:
        """Ask libca for a number of each PV that is connected."""
        with self.lock:
            return {number: int(what(self.handles[number])) for number in self.present}

    def open(self) -> None:
        """Create all channels and start to search for them."""
        with self.lock:
            for number in range(len(self.pvs)):
                self._create(number)
            self.generation += 1
        self._context.flush()

    def reopen_away(self) -> int:
        """Clear and create anew the channels that are away.

        libca searches for a lost channel at intervals that grow to 18 s; for a new one it starts
        again at 30 ms.

        Returns:
            How many there were.
        """
        away = np.flatnonzero(~self.connected[self._first])
        if not away.size:
            return 0
        with self.lock:
            for number in away.tolist():
                self._library.ca_clear_channel(self.handles[number])
                if self.connected[self._first[number]]:  # came back by itself just now
                    self._set_connected(number, False)
                self._create(number)
            self.generation += 1
        self._context.flush()
        return int(away.size)

    def end_repeating(self) -> int:
        """End the subscriptions to properties whose events state nothing new.

        Returns:
            How many there were.
        """
        repeating = self._statements.repeating()
        if not repeating:
            return 0
        with self.lock:
            for number in repeating:
                event, self._property_events[number] = self._property_events[number], None
                if event is not None:
                    self._library.ca_clear_subscription(event)
        self._context.flush()
        return len(repeating)

    def forget(self) -> None:
        """Take no request any more: the context is about to end."""
        with self.lock:
            self.connected[:] = False

    def _create(self, number: int) -> None:
        library, name = self._library, self.pvs[number].name
        handle = ctypes.c_void_p()
        # The handler may be called before the handle is known here: the user word says who it is.
        status = library.ca_create_channel(
            name.encode(),
            ctypes.cast(self._connection_handler, ctypes.c_void_p),
            number + 1,
            0,
            ctypes.byref(handle),
        )
        self._context.check(f"creating the channel {name}", status)
        self.handles[number] = handle.value
        status = library.ca_replace_access_rights_event(
            handle, ctypes.cast(self._access_handler, ctypes.c_void_p)
        )
        self._context.check(f"asking for the access rights of {name}", status)
        if self._monitor is not None:
            # Of an array as many values as it has, so that a short one is not filled up by zeros.
            is_array = self.pvs[number].elements is not None
            record = int(self._first[number]) * RECORD.itemsize
            status = library.ca_create_subscription(
                DBR_TIME_DOUBLE,
                0 if is_array else 1,
                handle,
                MONITOR_VALUE_AND_ALARM,
                ctypes.cast(
                    self._array_handler if is_array else self._scalar_handler, ctypes.c_void_p
                ),
                number + 1 if is_array else self._monitor.records.ctypes.data + record,
                None,
            )
            self._context.check(f"subscribing to {name}", status)
        if self._properties:
            event = ctypes.c_void_p()
            status = library.ca_create_subscription(
                DBR_CTRL_DOUBLE,
                1,
                handle,
                MONITOR_PROPERTY,
                ctypes.cast(self._property_handler, ctypes.c_void_p),
                number + 1,
                ctypes.byref(event),
            )
            self._property_events[number] = event.value
            self._context.check(f"subscribing to the properties of {name}", status)

    def _on_connection(self, arguments: ConnectionArguments) -> None:
        up = arguments.operation == OPERATION_UP
        number = self._library.ca_puser(arguments.channel) - 1
        pv = self.pvs[number]
        if up:
            keep_thread_state()
            # A circuit that answers again after a silence brings its channels back without an
            # access event, though it took their rights away by one.
            self.writable[pv.places] = bool(self._library.ca_write_access(arguments.channel))
            self._statements.came(number)
            self.servers[number] = self._context.host_of(arguments.channel)
            self.arrivals += 1
            if pv.elements is not None and self._monitor is not None:
                # What it held before it went away may be another value of nobody's doing.
                self._monitor.records["value"][pv.places] = np.nan
        self._set_connected(number, up)

    def _on_property(self, arguments: EventArguments) -> None:
        if arguments.status == ECA_NORMAL:
            self.restated += self._statements.is_new(arguments.user - 1, arguments)

    def _on_access(self, arguments: AccessArguments) -> None:
        number = self._library.ca_puser(arguments.channel) - 1
        self.writable[self.pvs[number].places] = bool(arguments.rights & WRITE_ACCESS)

    def _set_connected(self, number: int, up: bool) -> None:
        places = self.pvs[number].places
        self.losses += bool(self.connected[places[0]]) and not up
        self.connected[places] = up
        if self._changed is not None:
            for place in places.tolist():
                self._changed(place, up)

    def _pvs_where(self, mask: Mask) -> tuple[str, ...]:
        here = mask[self._first]
        return tuple(self.pvs[number].name for number in np.flatnonzero(here))

"""Channels of one kind: who is connected, who may be written, and searching anew for the rest."""

import ctypes
import threading
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.names import NamedPv, named_pvs
from orbitfb.core.signals import Mask
from orbitfb.epics.events import Monitor, array_handler, array_taker, guarded, scalar_handler
from orbitfb.epics.libca import (
    ACCESS_HANDLER,
    CONNECTION_HANDLER,
    DBR_TIME_DOUBLE,
    EVENT_HANDLER,
    MONITOR_VALUE_AND_ALARM,
    OPERATION_UP,
    WRITE_ACCESS,
    AccessArguments,
    ConnectionArguments,
    Context,
    keep_thread_state,
)
from orbitfb.epics.pva.channels import PvaChannels
from orbitfb.epics.pva.held import Held
from orbitfb.epics.records import RECORD
from orbitfb.epics.stated.contents import Contents
from orbitfb.epics.stated.property_events import PropertyEvents

NOT_HEARD = -1
"""Length of an array that has had no event."""

ChangeHandler = Callable[[int, bool], None]


class ChannelGroup:
    """Channels of one kind, in the order of their names.

    A name is a PV, or an element of an array (`core.names`): then it shares a channel with all
    other elements of that array. `connected` and `writable` are by name, what belongs to a channel
    is by PV. PVs over pvAccess (`pva://…`) have no handle: `pva` has their channels.

    Handlers run on libca's threads and on that of p4p, one at a time per context. `lock` is held
    while channels are created anew: whoever uses `handles` from another thread must hold it.

    Args:
        context: Where they live; the thread that calls `open` and `reopen_away` is attached to it.
        names: PVs, or elements of arrays.
        monitor: What to do with their events; None: no subscription.
        changed: Called with the place of each name and its state when its channel has come or gone.
        properties: Whether to be told when units or limits change.

    Attributes:
        properties: Hears of that.
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
        self.put_refused: Callable[[NamedPv, str], None] = lambda pv, told: None
        """Called when a put over pvAccess was refused, with what the server says."""
        self.lock = threading.Lock()
        self._context = context
        self._library = context.library
        self._monitor = monitor
        self._changed, self._stating = changed, properties
        self.properties = PropertyEvents(context, len(self.pvs), self._restate)
        # libca keeps the addresses of these: they must live as long as the context.
        lock = context.telling
        self._connection_handler = CONNECTION_HANDLER(guarded(self._on_connection, lock))
        self._access_handler = ACCESS_HANDLER(guarded(self._on_access, lock))
        if monitor is not None:
            array = array_handler(monitor, self.pvs, self.lengths)
            self._scalar_handler = EVENT_HANDLER(guarded(scalar_handler(monitor), lock))
            self._array_handler = EVENT_HANDLER(guarded(array, lock))
            self._take_array = array_taker(monitor, self.pvs, self.lengths)
        self.pva = self._over_pva()
        self.contents = Contents(self.pvs, size, self._kinds, self._sizes)

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
    def unheard(self) -> bool:
        """Whether an array is connected and has not told its values yet.

        Over pvAccess one that nobody has written to since its start has none; over Channel Access
        its size is told all the same.
        """
        return self._monitor is not None and any(
            self.lengths[number] < (1 if self.pvs[number].over_pva else 0)
            for number in self.present
            if self.pvs[number].elements is not None
        )

    def _kinds(self) -> dict[int, int]:
        held = {} if self.pva is None else self.pva.kinds
        return self._ask_each(self._library.ca_field_type) | held

    def _sizes(self) -> dict[int, int]:
        held = {} if self.pva is None else self.pva.sizes
        return self._ask_each(self._library.ca_element_count) | held

    def _ask_each(self, what: Callable[[int | None], int]) -> dict[int, int]:
        """Ask libca for a number of each PV that is connected."""
        with self.lock:
            return {
                number: int(what(self.handles[number]))
                for number in self.present
                if not self.pvs[number].over_pva
            }

    def open(self) -> None:
        """Create all channels and start to search for them."""
        with self.lock:
            for number, pv in enumerate(self.pvs):
                if not pv.over_pva:
                    self._create(number)
            self.generation += 1
        self._context.flush()
        if self.pva is not None:
            self.pva.open()

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
        if self.pva is not None:
            self.pva.search()
        with self.lock:
            for number in away.tolist():
                if self.pvs[number].over_pva:
                    continue
                self._library.ca_clear_channel(self.handles[number])
                if self.connected[self._first[number]]:  # came back by itself just now
                    self._set_connected(number, False)
                self._create(number)
            self.generation += 1
        self._context.flush()
        return int(away.size)

    def forget(self) -> None:
        """Take no request any more: the context is about to end."""
        with self.lock:
            self.connected[:] = False
        if self.pva is not None:
            self.pva.close()

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
            record = int(self._first[number]) * RECORD.itemsize
            # Of an array as many values as it has, so that a short one is not filled up by zeros.
            if self.pvs[number].elements is None:
                count, its = 1, self._scalar_handler
                user = self._monitor.records.ctypes.data + record
            else:
                count, its, user = 0, self._array_handler, number + 1
            what = (DBR_TIME_DOUBLE, count, MONITOR_VALUE_AND_ALARM)
            self._context.subscribe(name, handle, what, its, user)
        if self._stating:
            self.properties.subscribe(number, name, handle)

    def _on_connection(self, arguments: ConnectionArguments) -> None:
        up = arguments.operation == OPERATION_UP
        number = self._library.ca_puser(arguments.channel) - 1
        if up:
            keep_thread_state()
            # A circuit that answers again after a silence brings its channels back without an
            # access event, though it took their rights away by one.
            writable = bool(self._library.ca_write_access(arguments.channel))
            self.properties.came(number)
            self._came(number, writable, self._context.host_of(arguments.channel))
        self._set_connected(number, up)

    def _came(self, number: int, writable: bool, server: str) -> None:
        pv = self.pvs[number]
        self.writable[pv.places] = writable
        self.servers[number] = server
        self.arrivals += 1
        if pv.elements is not None and self._monitor is not None:
            # What it held before it went away may be another value of nobody's doing.
            self._monitor.records["value"][pv.places] = np.nan

    def _over_pva(self) -> PvaChannels | None:
        """Make the channels of PVs over pvAccess, if there are any."""
        over_pva = {number: pv for number, pv in enumerate(self.pvs) if pv.over_pva}
        lock = self._context.telling
        if not over_pva or lock is None:
            return None
        return PvaChannels(self._context.pva, lock, over_pva, self)

    def pva_came(self, number: int) -> None:
        """Take that a PV over pvAccess is connected."""
        self._came(number, True, "")
        self._set_connected(number, True)

    def pva_gone(self, number: int) -> None:
        """Take that it is away."""
        self._set_connected(number, False)

    def pva_told(self, number: int, held: Held, changed: bool) -> None:
        """Take a new value; changed: it states another unit or other limits than before."""
        self.restated += changed
        if self._monitor is not None:
            self._take_array(number, held.head, held.values)

    def pva_refused(self, number: int, words: str) -> None:
        """Take that its server refuses a put."""
        self.put_refused(self.pvs[number], words)

    def _restate(self) -> None:
        self.restated += 1

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

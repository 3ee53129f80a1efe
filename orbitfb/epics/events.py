"""Handlers of monitor events: they run on libca's threads, so they do next to nothing."""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.names import NamedPv
from orbitfb.core.signals import Vector
from orbitfb.epics.libca import ECA_NORMAL, EventArguments, move_memory
from orbitfb.epics.records import RECORD

Head = tuple[int, int, int, int]
"""What comes before the values: status, severity, seconds since the EPICS epoch, nanoseconds."""

BEFORE_VALUES = np.dtype(
    {
        "names": ["status", "severity", "seconds", "nanoseconds"],
        "formats": [np.int16, np.int16, np.uint32, np.uint32],
        "offsets": [0, 2, 4, 8],
        "itemsize": 16,
    }
)
"""What stands in a `dbr_time_double` before its values."""


@dataclass(frozen=True, slots=True)
class Monitor:
    """What to do with the events of a group.

    Args:
        records: One record per name, written in place.
        arrived: Called after each event with the count of records that it brought; True when a
            vector has become complete. None: not counted.
        complete: Called when `arrived` said so, before the next event is written.
        heard: Called after each event with the place of each record that it changed; None: nobody.
    """

    records: NDArray[np.void]
    arrived: Callable[[int], bool] | None = None
    complete: Callable[[], None] | None = None
    heard: Callable[[int], None] | None = None


Event = TypeVar("Event")


def guarded(handler: Callable[[Event], None], lock: "Lock | None") -> Callable[[Event], None]:
    """Let no handler of another thread run beside this one; without a lock there is none."""
    if lock is None:
        return handler

    def alone(event: Event) -> None:
        with lock:
            handler(event)

    return alone


def scalar_handler(monitor: Monitor) -> Callable[[EventArguments], None]:
    """Return the handler of events of one value; the user word is the address of its record."""
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
            if arrived(1):
                complete()

    return keep_and_count


def array_taker(
    monitor: Monitor, pvs: Sequence[NamedPv], lengths: NDArray[np.int64]
) -> Callable[[int, Head, Vector], None]:
    """Return what takes the values of a whole PV: number of the PV, head, and values.

    An element that the array does not have is NaN, as one that the machine marks so.

    Args:
        monitor: What to do with them.
        pvs: The PVs of the group.
        lengths: Gets how many values each of them had in its last event, shape (k,).
    """
    records, arrived, complete, heard = (
        monitor.records,
        monitor.arrived,
        monitor.complete,
        monitor.heard,
    )
    columns = [records[name] for name in BEFORE_VALUES.names or ()]
    values = records["value"]

    def take(number: int, head: Head, given: Vector) -> None:
        pv = pvs[number]
        places, elements = pv.places, pv.elements
        lengths[number] = len(given)
        if pv.length > len(given):
            given = np.append(given, np.full(pv.length - len(given), np.nan))
        new = given[:1] if elements is None else given[elements]
        for column, its in zip(columns, head, strict=True):
            column[places] = its
        if heard is not None:
            changed = places[values[places] != new].tolist()
            values[places] = new
            for place in changed:
                heard(place)
            return
        values[places] = new
        if arrived is not None and complete is not None and arrived(len(places)):
            complete()

    return take


def array_handler(
    monitor: Monitor, pvs: Sequence[NamedPv], lengths: NDArray[np.int64]
) -> Callable[[EventArguments], None]:
    """Return the handler of events of arrays; the user word is the number of the PV, from 1 on.

    Args:
        monitor: What to do with them.
        pvs: The PVs of the group.
        lengths: Gets how many values each of them had in its last event, shape (k,).
    """
    take, header = array_taker(monitor, pvs, lengths), BEFORE_VALUES.itemsize

    def keep(arguments: EventArguments) -> None:
        if arguments.status == ECA_NORMAL:
            data = ctypes.string_at(arguments.data, header + 8 * arguments.count)
            head = np.frombuffer(data, BEFORE_VALUES, 1)[0].item()
            take(arguments.user - 1, head, np.frombuffer(data[header:]))

    return keep

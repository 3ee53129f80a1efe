"""Handlers of monitor events: they run on libca's threads, so they do next to nothing."""

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.names import NamedPv
from orbitfb.epics.libca import ECA_NORMAL, EventArguments, move_memory
from orbitfb.epics.records import RECORD

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


def array_handler(
    monitor: Monitor, pvs: Sequence[NamedPv], lengths: NDArray[np.int64]
) -> Callable[[EventArguments], None]:
    """Return the handler of events of arrays; the user word is the number of the PV, from 1 on.

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
    columns = [(records[name], name) for name in BEFORE_VALUES.names or ()]
    header = BEFORE_VALUES.itemsize
    values = records["value"]

    def keep(arguments: EventArguments) -> None:
        if arguments.status != ECA_NORMAL:
            return
        number = arguments.user - 1
        places, elements = pvs[number].places, pvs[number].elements
        data = ctypes.string_at(arguments.data, header + 8 * arguments.count)
        first, given = np.frombuffer(data, BEFORE_VALUES, 1)[0], np.frombuffer(data[header:])
        lengths[number] = len(given)
        if elements is None or pvs[number].length > len(given):
            given = np.append(given, np.full(pvs[number].length - len(given), np.nan))
        new = given if elements is None else given[elements]
        for column, name in columns:
            column[places] = first[name]
        changed = places[values[places] != new] if heard is not None else ()
        values[places] = new
        if heard is not None:
            for place in changed:
                heard(int(place))
        elif arrived is not None and complete is not None and arrived(len(places)):
            complete()

    return keep

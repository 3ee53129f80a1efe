"""Devices behind columns, from what these are called."""

from collections.abc import Sequence

from orbitfb.records.cells import cells_of
from orbitfb.records.layout import ChannelPlane, Devices


def devices_of(
    names: Sequence[str], planes: Sequence[ChannelPlane], channels: Sequence[str] = ()
) -> Devices:
    """Describe the devices behind columns; their cells come from their names.

    Args:
        names: k names.
        planes: k planes.
        channels: What a record calls them, if not so.
    """
    return Devices(tuple(names), tuple(planes), cells_of(names, planes), tuple(channels))

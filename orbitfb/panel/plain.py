"""What came over the wire, looked at before caproto converts it."""

from array import array
from typing import Any

from caproto import ChannelType

from orbitfb.core.errors import ControlError
from orbitfb.panel.pv import Kind, PanelPv

PLAIN = frozenset(
    {
        ChannelType.STRING,
        ChannelType.INT,
        ChannelType.FLOAT,
        ChannelType.ENUM,
        ChannelType.CHAR,
        ChannelType.LONG,
        ChannelType.DOUBLE,
    }
)
"""Types that carry a value and nothing besides: limits and alarms are not the client's to set."""


def plain(pv: PanelPv, data: Any, data_type: ChannelType) -> tuple[Any, ChannelType]:
    """Check what came over the wire before it is converted, as that hides what is wrong.

    Args:
        pv: The PV that is written.
        data: As it came.
        data_type: Of the data.

    Returns:
        Data and type to go on with: a text that came as a string is made one of characters.

    Raises:
        ControlError: It is no plain value, is empty, or a fraction where there are none.
    """
    if data_type not in PLAIN:
        raise ControlError(f"{pv.name} takes plain values only, not {data_type!r}")
    elements: list[Any] = [*data]
    if not elements or elements in ([b""], [""]):
        raise ControlError(f"{pv.name}: the written value is empty")
    if data_type in (ChannelType.FLOAT, ChannelType.DOUBLE):
        whole = pv.kind in (Kind.INTEGER, Kind.SWITCHES, Kind.CHOICE)
        if whole and not all(float(element).is_integer() for element in elements):
            raise ControlError(f"{pv.name} takes whole numbers only")
    if pv.kind is Kind.TEXT and data_type is ChannelType.STRING and len(elements) == 1:
        return array("B", bytes(elements[0])), ChannelType.CHAR
    return data, data_type

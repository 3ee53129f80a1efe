"""What comes over the wire is looked at before caproto converts it."""

import asyncio
from array import array
from typing import Any

import pytest
from caproto import AlarmSeverity, CaprotoConversionError, ChannelType

from orbitfb.core.errors import ControlError
from orbitfb.panel.channels import Origin, channel_of
from orbitfb.panel.pv import PanelPv
from orbitfb.panel.pv_table import Extent, panel_pvs
from orbitfb.panel.settings import PanelSettings

BY_NAME = {pv.name: pv for pv in panel_pvs(PanelSettings(), Extent("x", 4, 4))}


class Desk:
    """Lets everybody write and notes what it is asked and told."""

    def __init__(self) -> None:
        self.obeyed: list[Any] = []
        self.told: list[str] = []

    def may_write(self, pv: PanelPv, origin: Origin) -> bool:
        return bool(pv.name and origin.user)

    async def obey(self, pv: PanelPv, value: Any, origin: Origin) -> None:
        self.obeyed.append(value)

    def refused(self, pv: PanelPv, value: Any, origin: Origin, reason: str) -> None:
        self.told.append(reason)


def write(name: str, data: Any, data_type: ChannelType) -> tuple[Desk, Any]:
    desk = Desk()
    channel = channel_of(BY_NAME[name], desk)

    async def wire() -> None:
        await channel.auth_write("127.0.0.1", "operator", data, data_type, None)

    try:
        asyncio.run(wire())
    except (ControlError, CaprotoConversionError):
        assert not desk.obeyed
    return desk, channel


@pytest.mark.parametrize(
    ("name", "data", "data_type", "reason"),
    [
        ("Command-Cmd", array("d", [2.7]), ChannelType.DOUBLE, "whole numbers"),
        ("Refit-Cmd", array("f", [float("nan")]), ChannelType.FLOAT, "whole numbers"),
        ("Modes-SP", array("d", [2.7]), ChannelType.DOUBLE, "whole numbers"),
        ("BpmEnable-SP", array("d", [1, 1, 0.99, 1]), ChannelType.DOUBLE, "whole numbers"),
        ("GainX-SP", [b""], ChannelType.STRING, "written value is empty"),
        ("GainX-SP", array("d"), ChannelType.DOUBLE, "written value is empty"),
        ("ReferenceLoad-Cmd", array("B"), ChannelType.CHAR, "written value is empty"),
        ("GainX-SP", [b"much"], ChannelType.STRING, "GainX-SP cannot take that"),
        ("Command-Cmd", [b"OPEN"], ChannelType.STRING, "Command-Cmd cannot take that"),
        ("GainX-SP", array("d", [0.5, 0.5]), ChannelType.DOUBLE, "GainX-SP cannot take that"),
        ("GainX-SP", array("d", [0.5]), ChannelType.CTRL_DOUBLE, "plain values only"),
        ("GainX-SP", array("H", [1]), ChannelType.PUT_ACKT, "plain values only"),
    ],
)
def test_what_cannot_be_taken_is_an_error_an_alarm_and_a_line(
    name: str, data: Any, data_type: ChannelType, reason: str
):
    desk, channel = write(name, data, data_type)
    assert not desk.obeyed
    assert len(desk.told) == 1 and reason in desk.told[0]
    assert channel.severity == AlarmSeverity.MAJOR_ALARM


@pytest.mark.parametrize(
    ("name", "data", "data_type", "value"),
    [
        ("Command-Cmd", array("d", [2.0]), ChannelType.DOUBLE, 2),
        ("Command-Cmd", [b"close"], ChannelType.STRING, 3),
        ("BpmEnable-SP", array("d", [1, 0, 1, 1]), ChannelType.DOUBLE, [1, 0, 1, 1]),
        ("GainX-SP", [b"0.5"], ChannelType.STRING, 0.5),
        ("ReferenceSave-Cmd", [b"golden"], ChannelType.STRING, "golden"),  # caput without -S
        ("ReferenceSave-Cmd", array("B", b"golden"), ChannelType.CHAR, "golden"),
    ],
)
def test_what_can_be_taken_is_done(name: str, data: Any, data_type: ChannelType, value: Any):
    desk, channel = write(name, data, data_type)
    assert desk.obeyed == [value] and not desk.told
    assert channel.severity == AlarmSeverity.NO_ALARM

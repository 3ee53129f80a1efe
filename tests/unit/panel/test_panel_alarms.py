"""The state of the loop as an alarm, for the alarm tree of the control room."""

import asyncio

from caproto import AlarmSeverity, AlarmStatus

from orbitfb.panel.channels import channel_of, show
from orbitfb.panel.pv import Severity
from orbitfb.panel.pv_table import STATES, Extent, panel_pvs
from orbitfb.panel.settings import PanelSettings

BY_NAME = {pv.name: pv for pv in panel_pvs(PanelSettings(), Extent("x", 6, 4))}


class _Nobody:
    """A desk that nobody writes to."""


def shown(name: str, *values: object) -> list[tuple[object, AlarmStatus, AlarmSeverity]]:
    channel = channel_of(BY_NAME[name], _Nobody())
    seen = []

    async def show_all() -> None:
        for value in values:
            await show(channel, value)
            seen.append((channel.value, channel.status, channel.severity))

    asyncio.run(show_all())
    return seen


def test_every_state_has_its_severity():
    severities = {state: BY_NAME["State-I"].severity(state) for state in STATES}
    assert {state for state, its in severities.items() if its is Severity.MINOR} == {"HELD"}
    assert {s for s, its in severities.items() if its is Severity.MAJOR} == {"TRIPPED", "FAULT"}


def test_a_state_shows_with_its_alarm_and_loses_it():
    seen = shown("State-I", "CLOSED", "TRIPPED", "TRIPPED", None, "TRIPPED", "HELD", "OPEN")
    assert [severity for _, _, severity in seen] == [
        AlarmSeverity.NO_ALARM,
        AlarmSeverity.MAJOR_ALARM,
        AlarmSeverity.MAJOR_ALARM,
        AlarmSeverity.INVALID_ALARM,
        AlarmSeverity.MAJOR_ALARM,
        AlarmSeverity.MINOR_ALARM,
        AlarmSeverity.NO_ALARM,
    ]
    assert seen[1][1] is AlarmStatus.STATE and seen[-1][1] is AlarmStatus.NO_ALARM


def test_a_masked_bpm_is_a_minor_alarm():
    severities = [severity for _, _, severity in shown("BpmsInvalid-I", 0, 1, 2, 0)]
    minor = AlarmSeverity.MINOR_ALARM
    assert severities == [AlarmSeverity.NO_ALARM, minor, minor, AlarmSeverity.NO_ALARM]

"""The PVs of the panel as caproto knows them."""

import contextvars
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from caproto import (
    AccessRights,
    AlarmSeverity,
    AlarmStatus,
    CaprotoError,
    ChannelChar,
    ChannelDouble,
    ChannelEnum,
    ChannelInteger,
    ChannelString,
    ChannelType,
)

from orbitfb.core.errors import ControlError
from orbitfb.core.printable import plain as plain_text
from orbitfb.panel.plain import plain
from orbitfb.panel.pv import Kind, PanelPv, out_of_range


@dataclass(frozen=True, slots=True)
class Origin:
    """Whom a write comes from.

    Args:
        user: As the client claims.
        address: Where its connection comes from.
    """

    user: str
    address: str


LONGEST_NAME = 60
"""Most characters of a claimed name that are kept."""


def claimed(name: str | None) -> str:
    """Give a user's name as a client claims it, fit for logs and terminals.

    Args:
        name: Of anybody; None: nothing is claimed.
    """
    return plain_text(name or "", LONGEST_NAME)


class Desk(Protocol):
    """What the channels need of whoever answers for them."""

    def may_write(self, pv: PanelPv, origin: Origin) -> bool:
        """Say whether somebody may write a PV."""
        ...

    async def obey(self, pv: PanelPv, value: Any, origin: Origin) -> None:
        """Do what was written; raise what refuses it."""
        ...

    def refused(self, pv: PanelPv, value: Any, origin: Origin, reason: str) -> None:
        """Take note of a write that was refused before anybody was asked."""
        ...


_writer: contextvars.ContextVar[Origin | None] = contextvars.ContextVar("writer", default=None)
"""Whom the write comes from that this task carries out; None: it is our own."""


class _Panel:
    """What all channels of the panel do with a write that comes from a client."""

    pv: PanelPv
    desk: Desk

    def check_access(self, hostname: str, username: str) -> AccessRights:
        """Let everybody read; say who may write."""
        origin = Origin(claimed(username), hostname or "")
        if self.pv.writable and self.desk.may_write(self.pv, origin):
            return AccessRights.READ | AccessRights.WRITE
        return AccessRights.READ

    async def auth_write(
        self,
        hostname: str,
        username: str,
        data: Any,
        data_type: Any,
        metadata: Any,
        **options: Any,
    ) -> Any:
        """Carry out a client's write, or refuse it and say why."""
        origin = Origin(claimed(username), hostname or "")
        # a rule may have been enough when the channel was made; a name can be claimed anew
        if AccessRights.WRITE not in self.check_access(hostname, username):
            reason = f"{origin.user}@{origin.address} may not write {self.pv.name}"
            self.desk.refused(self.pv, None, origin, reason)
            raise ControlError(reason)
        try:
            # caproto would turn a fraction into a choice or a switch, and nothing into 0
            data, data_type = plain(self.pv, data, ChannelType(data_type))
        except ControlError as error:
            await self._take_ill(data, origin, str(error))
            raise
        token = _writer.set(origin)
        try:
            inside: Any = super()
            return await inside.auth_write(hostname, username, data, data_type, metadata, **options)
        except (CaprotoError, ValueError) as error:  # it cannot even be converted
            reason = f"{self.pv.name} cannot take that: {str(error) or 'it has another type'}"
            await self._take_ill(data, origin, reason)
            raise ControlError(reason) from None
        finally:
            _writer.reset(token)

    async def _take_ill(self, data: Any, origin: Origin, reason: str) -> None:
        """Log what is refused before its value is looked at, and put the PV in alarm."""
        self.desk.refused(self.pv, data, origin, reason)
        channel: Any = self
        await channel.alarm.write(status=AlarmStatus.WRITE, severity=AlarmSeverity.MAJOR_ALARM)

    async def verify_value(self, data: Any) -> Any:
        """Check what a client writes and have it done, before the PV shows it."""
        origin = _writer.get()
        if origin is None:
            return data
        try:
            value = checked(self.pv, data)
        except ControlError as error:
            self.desk.refused(self.pv, data, origin, str(error))
            raise
        await self.desk.obey(self.pv, value, origin)
        channel: Any = self
        channel.status, channel.severity = AlarmStatus.NO_ALARM, AlarmSeverity.NO_ALARM
        return self.pv.states[value] if self.pv.kind is Kind.CHOICE else data

    def get_field(self, field: str) -> Any:
        """Give the field of the record; there is only the value."""
        if field != "VAL":
            raise KeyError(field)
        return self


def checked(pv: PanelPv, data: Any) -> Any:
    """Check what a client wrote.

    Args:
        pv: The PV.
        data: As caproto hands it over.

    Returns:
        A number, a list of numbers, a text, or the index of a choice.

    Raises:
        ControlError: It is beyond the limits, not finite, too long, or no choice.
    """
    match pv.kind:
        case Kind.CHOICE:
            return _choice(pv, data)
        case Kind.TEXT:
            text = str(data).strip("\0 \n")
            if not (text.isascii() and text.isprintable()):
                raise ControlError(f"{pv.name} takes printable ASCII text only")
            return text
        case _:
            value = data.tolist() if hasattr(data, "tolist") else data
            elements: list[Any] = [*value] if isinstance(value, list | tuple) else [value]
            if problem := out_of_range(pv, elements):
                raise ControlError(problem)
            return elements if pv.kind in (Kind.DOUBLES, Kind.SWITCHES) else elements[0]


def _choice(pv: PanelPv, data: Any) -> int:
    value = data.tolist() if hasattr(data, "tolist") else data
    elements: list[Any] = [*value] if isinstance(value, list | tuple) else [value]
    match elements:
        case [str(word)] if word in pv.states:
            return pv.states.index(word)
        case [int(number)] if 0 <= number < len(pv.states):
            return number
        case _:
            raise ControlError(f"{pv.name} has no choice {value!r}; it has {', '.join(pv.states)}")


class _Double(_Panel, ChannelDouble):
    pass


class _Integer(_Panel, ChannelInteger):
    pass


class _Choice(_Panel, ChannelEnum):
    pass


class _Text(_Panel, ChannelChar):
    pass


class _Names(_Panel, ChannelString):
    pass


_Make = Callable[[PanelPv], Any]


def _limits(pv: PanelPv, number: type[int] | type[float] = float) -> dict[str, Any]:
    low, high = map(number, pv.limits)
    return {
        "units": pv.units,
        "lower_ctrl_limit": low,
        "upper_ctrl_limit": high,
        "lower_disp_limit": low,
        "upper_disp_limit": high,
    }


_MAKERS: dict[Kind, _Make] = {
    Kind.DOUBLE: lambda pv: _Double(value=0.0, precision=pv.precision, **_limits(pv)),
    Kind.INTEGER: lambda pv: _Integer(value=0, **_limits(pv, int)),
    Kind.CHOICE: lambda pv: _Choice(value=pv.states[0], enum_strings=pv.states),
    Kind.TEXT: lambda pv: _Text(value="", max_length=pv.length),
    Kind.DOUBLES: lambda pv: _Double(
        value=[0.0] * pv.length, precision=pv.precision, max_length=pv.length, **_limits(pv)
    ),
    Kind.SWITCHES: lambda pv: _Integer(value=[1] * pv.length, max_length=pv.length),
    Kind.NAMES: lambda pv: _Names(value=[""] * pv.length, max_length=pv.length),
}


def channel_of(pv: PanelPv, desk: Desk) -> Any:
    """Make the channel of a PV."""
    channel = _MAKERS[pv.kind](pv)
    channel.pv, channel.desk = pv, desk
    return channel


async def show(channel: Any, value: Any) -> None:
    """Show a value of our own; None is shown as unknown: the old one, INVALID.

    Args:
        channel: Of the panel.
        value: In the units of the PV, or None.
    """
    if value is None:
        if channel.severity is not AlarmSeverity.INVALID_ALARM:
            await channel.alarm.write(status=AlarmStatus.UDF, severity=AlarmSeverity.INVALID_ALARM)
        return
    if channel.pv.kind is Kind.TEXT:
        value = printable(value)
    elif isinstance(value, list):  # an element that is not known
        value = [math.nan if element is None else element for element in value]
    unknown = channel.severity is AlarmSeverity.INVALID_ALARM
    if channel.pv.alarms:
        worse = channel.pv.severity(value)
        if _same(channel.value, value) and int(channel.severity) == worse:
            return
        status = AlarmStatus.STATE if worse else AlarmStatus.NO_ALARM
        await channel.write(value, status=status, severity=AlarmSeverity(worse))
        return
    if unknown:
        channel.status, channel.severity = AlarmStatus.NO_ALARM, AlarmSeverity.NO_ALARM
    elif _same(channel.value, value):
        return
    await channel.write(value)


def _same(before: Any, value: Any) -> bool:
    if isinstance(value, list):
        return list(before) == value
    return bool(before == value)


def printable(text: str) -> str:
    """Give a text as every client can show it: ASCII, not too long."""
    plain = text.replace("µ", "u").replace("\u2212", "-").replace("R̂", "R")
    return plain.encode("ascii", "replace").decode()[:1000]

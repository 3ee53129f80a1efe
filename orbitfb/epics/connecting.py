"""Waiting for all channels at the start, and saying everything that is wrong with them at once."""

import time
from collections.abc import Collection, Sequence

from orbitfb.core.errors import ConnectError, MachineError, few
from orbitfb.core.ports import Clock
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
from orbitfb.epics.requests import Getter
from orbitfb.epics.settings import EpicsSettings
from orbitfb.epics.units import bpm_contradiction, corrector_contradiction

LOOK_EVERY = 0.01


def wait_for_channels(
    groups: Sequence[ChannelGroup],
    setpoints: ChannelGroup,
    settings: EpicsSettings,
    clock: Clock,
    waived: Collection[str] = (),
) -> None:
    """Wait until every channel is connected and every setpoint may be written.

    Args:
        groups: All channels, searched for already.
        setpoints: The group among them that is written to.
        settings: How long to wait, and what to name in the advice.
        clock: Clock that says when the time is over.
        waived: PVs that need not be there, or, of setpoints, that need not be writable: the loop
            does not use them.

    Raises:
        ConnectError: PVs that did not connect in time, all of them.
        MachineError: Setpoints that may not be written or hold no real number, all of them.
    """
    deadline = clock.monotonic() + settings.connect_timeout
    while _missing(groups, setpoints, waived):
        if clock.monotonic() >= deadline:
            break
        time.sleep(LOOK_EVERY)
    missing = _missing(groups, setpoints, waived)
    if missing:
        total = sum(len(group) for group in groups)
        places = " ".join(filter(None, (settings.address_list, settings.name_servers)))
        advice = (
            f"Is the IOC running, and reachable at '{places}' port {settings.server_port}? "
            f"Are the names right ({_origin(missing, settings)})? "
            "`orbitfb doctor` with the same --ioc and --config counts them by kind."
        )
        raise ConnectError(missing, total, settings.connect_timeout, advice)
    if read_only := [name for name in setpoints.read_only if name not in waived]:
        raise MachineError(
            f"{len(read_only)} of {len(setpoints)} setpoints may not be written:\n"
            f"{few(read_only)}\n"
            "Ask for write access for this host and user."
        )
    if not_real := setpoints.not_real:
        raise MachineError(
            f"{len(not_real)} of {len(setpoints)} setpoints cannot hold a current:\n"
            f"{few(not_real)}\n"
            "Name the PV of the current [A] in the places table: a record of type ao."
        )


def _origin(missing: Sequence[str], settings: EpicsSettings) -> str:
    """Say where in the configuration the names are from."""
    slow = {its.pv for its in settings.auxiliary.values()}
    sources = {"epics.auxiliary" if name in slow else "the places table" for name in missing}
    return " and ".join(sorted(sources, reverse=True))


def _missing(
    groups: Sequence[ChannelGroup], setpoints: ChannelGroup, waived: Collection[str]
) -> list[str]:
    """List the PVs that are needed and away; every setpoint is needed, as records tell it."""
    return [
        name
        for group in groups
        for name in group.disconnected
        if group is setpoints or name not in waived
    ]


def check_units(context: Context, groups: Sequence[ChannelGroup], settings: EpicsSettings) -> None:
    """Refuse PVs that state another unit than the configuration.

    Args:
        context: Of the groups.
        groups: BPMs, setpoints and readbacks, connected; what follows is not looked at.
        settings: Has the unit of the BPMs.

    Raises:
        MachineError: Some do; the first are named.
    """
    bpms, setpoints, readbacks, *_ = groups
    stated = {
        group: Getter(context, group, settings.answer_timeout).units()
        for group in (bpms, setpoints, readbacks)
    }
    wrong = [bpm_contradiction(bpms.names, stated[bpms], settings.bpm_unit)]
    wrong += [corrector_contradiction(its.names, stated[its]) for its in (setpoints, readbacks)]
    if told := "\n".join(filter(None, wrong)):
        raise MachineError(told)

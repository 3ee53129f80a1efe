"""Waiting for all channels at the start, and saying everything that is wrong with them at once."""

import time
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ConnectError, MachineError, few
from orbitfb.core.names import RF_FREQUENCY, RF_READBACK
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Channels, Mask
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.libca import Context
from orbitfb.epics.oscillator import EpicsOscillator
from orbitfb.epics.requests import Getter
from orbitfb.epics.settings import EpicsSettings
from orbitfb.epics.units import corrector_contradiction, metres_of, plain_unit

LOOK_EVERY = 0.01


def wait_for_channels(
    groups: Sequence[ChannelGroup],
    setpoints: ChannelGroup,
    settings: EpicsSettings,
    clock: Clock,
    waived: Collection[str] = (),
    origin: Mapping[str, str] | None = None,
) -> None:
    """Wait until every channel is connected and every setpoint may be written.

    Args:
        groups: All channels, searched for already.
        setpoints: The group among them that is written to.
        settings: How long to wait, and what to name in the advice.
        clock: Clock that says when the time is over.
        waived: PVs that need not be there, or, of setpoints, that need not be writable: the loop
            does not use them.
        origin: Key of the configuration that names a PV, where it is none of `epics`.

    Raises:
        ConnectError: PVs that did not connect in time, all of them.
        MachineError: Setpoints that may not be written or hold no real number, all of them.
    """
    deadline = clock.monotonic() + settings.connect_timeout
    while _missing(groups, setpoints, waived) or any(group.unheard for group in groups):
        if clock.monotonic() >= deadline:
            break
        time.sleep(LOOK_EVERY)
    missing = _missing(groups, setpoints, waived)
    if missing:
        total = sum(len(group.pvs) for group in groups)
        advice = (
            f"Is the IOC running, and reachable at '{settings.searched}' port "
            f"{settings.server_port}? "
            f"Are the names right ({_origin(missing, settings, origin or {})})? "
            "`orbitfb doctor` with the same --ioc and --config counts them by kind."
        )
        raise ConnectError(missing, total, settings.connect_timeout, advice)
    if read_only := [name for name in setpoints.read_only if name not in waived]:
        raise MachineError(
            f"{len(read_only)} of {len(setpoints.pvs)} setpoints may not be written:\n"
            f"{few(read_only)}\n"
            "Ask for write access for this host and user."
        )
    ours = [group for group in groups if not {pv.name for pv in group.pvs} & set(origin or ())]
    if short := [told for group in ours for told in group.contents.odd_arrays]:
        raise MachineError(
            f"{len(short)} array PVs do not hold what is named:\n{few(short)}\nCount elements from "
            "0 in the places table, and see how many values the record holds (NELM)."
        )
    if unnamed := setpoints.contents.not_whole:
        raise MachineError(
            f"{len(unnamed)} array PVs of setpoints can only be written as a whole:\n"
            f"{few(unnamed)}\nName each element in the places table, with a corrector that is "
            "disabled where nothing is to be moved."
        )
    if wrong := setpoints.contents.not_numbers:
        raise MachineError(
            f"{len(wrong)} of {len(setpoints.pvs)} setpoints cannot hold a current:\n"
            f"{few(wrong)}\n"
            "Name the PV of the current [A] in the places table: a record of type ao."
        )


def waived(channels: Channels, counting: Mask | None, movable: Mask | None) -> frozenset[str]:
    """List the PVs of masked devices: they need not be there at the start, nor be writable.

    Args:
        channels: Names of the PVs.
        counting: BPMs that are not masked, shape (n,); None: all.
        movable: Correctors that are not masked, shape (m,); None: all.
    """
    names: set[str] = set()
    if counting is not None:
        names |= {channels.orbit_pvs[index] for index in np.flatnonzero(~counting)}
    if movable is not None:
        masked = np.flatnonzero(~movable)
        names |= {channels.readback_pvs[index] for index in masked}
        names |= {channels.setpoint_pvs[index] for index in masked}
    return frozenset(names)


def steps_of(setpoints: ChannelGroup, settings: EpicsSettings) -> NDArray[np.float64]:
    """Give the step of each setpoint, shape (m,) [A]; 0: it holds any value.

    Args:
        setpoints: Connected.
        settings: Has the step that records round to.
    """
    step = settings.setpoint_step
    return np.where(setpoints.contents.whole, max(np.ceil(step), 1.0), step)


def _origin(missing: Sequence[str], settings: EpicsSettings, others: Mapping[str, str]) -> str:
    """Say where in the configuration the names are from."""
    slow = {its.pv: name for name, its in settings.auxiliary.items()}
    rf = (RF_FREQUENCY, RF_READBACK)
    sources = {
        others.get(name, "the places table")
        if name not in slow
        else "epics.auxiliary, rf.setpoint_pv, rf.readback_pv"
        if slow[name] in rf
        else "epics.auxiliary"
        for name in missing
    }
    return " and ".join(sorted(sources, reverse=True))


def _missing(
    groups: Sequence[ChannelGroup], setpoints: ChannelGroup, waived: Collection[str]
) -> list[str]:
    """List the PVs that are needed and away; every setpoint is needed, as records tell it."""
    missing = [
        name
        for group in groups
        for name in group.disconnected
        if group is setpoints or name not in waived
    ]
    return list(dict.fromkeys(missing))  # the RF setpoint is read and written


class UnitWatch:
    """Knows the units that PVs stated at the start, and sees when one states another.

    A record that is loaded anew or edited may state another unit: its numbers mean something else
    from then on, by powers of ten. Whoever repaired it has to say so by a new start.

    Args:
        context: Of the groups.
        groups: BPMs, setpoints and readbacks, connected; what follows is not looked at.
        settings: Has the unit of the BPMs.
        said: Of each BPM, by the places table; empty: nothing.

    Attributes:
        metres: Length of the unit of each BPM, shape (n,) [m]; NaN for one that is away and has
            none.
        told: What the last look came to.

    Raises:
        MachineError: PVs state another unit than the configuration.
    """

    def __init__(
        self,
        context: Context,
        groups: Sequence[ChannelGroup],
        settings: EpicsSettings,
        said: Sequence[str] = (),
    ) -> None:
        self._context, self._groups, self._settings = context, tuple(groups[:3]), settings
        self._arrivals = self._count()
        self._stated = self._ask()
        self.metres = compare_units(self._groups, self._stated, settings, said)
        self.told = ""

    def look(self) -> str:
        """Say which PVs state another unit than at the start; empty: none does.

        PVs are asked once they have come, or say that something of theirs has changed, in the
        reader's thread.
        """
        if (arrivals := self._count()) == self._arrivals:
            return self.told
        now = self._ask()
        told: list[str] = []
        silent = False
        for group, before, stated in zip(self._groups, self._stated, now, strict=True):
            here = group.connected
            known = np.array([bool(text) for text in stated]) & here
            silent |= bool((here & ~known & np.array([bool(text) for text in before])).any())
            changed = known & np.array(
                [plain_unit(a) != plain_unit(b) for a, b in zip(before, stated, strict=True)]
            )
            changed &= np.array([bool(text) for text in before])
            if changed.any():
                first = int(changed.argmax())
                told.append(
                    f"{np.count_nonzero(changed)} PVs state another unit (EGU) than at the start, "
                    f"as {group.names[first]}: {stated[first]}, before {before[first]}; repair the "
                    "records, or start again with that unit"
                )
        self.told = "; ".join(told)
        if not silent:  # else they are asked again
            self._arrivals = arrivals
        return self.told

    def _count(self) -> int:
        return sum(group.arrivals + group.restated for group in self._groups)

    def _ask(self) -> list[list[str]]:
        wait = self._settings.answer_timeout
        return [Getter(self._context, group, wait).units() for group in self._groups]


def compare_units(
    groups: Sequence[ChannelGroup],
    stated: Sequence[Sequence[str]],
    settings: EpicsSettings,
    said: Sequence[str] = (),
) -> NDArray[np.float64]:
    """Refuse PVs that state another unit than the configuration.

    Args:
        groups: BPMs, setpoints and readbacks, connected; what follows is not looked at.
        stated: Units that they state (EGU).
        settings: Has the unit of the BPMs.
        said: Of each BPM, by the places table; empty: nothing.

    Returns:
        Length of the unit of each BPM, shape (n,) [m]; NaN for one that is away and has none.

    Raises:
        MachineError: Some do, or state none where it is needed; the first are named.
    """
    bpms = groups[0]
    metres, told = metres_of(bpms.names, stated[0], said, settings.bpm_unit, bpms.connected)
    wrong = [told]
    wrong += [
        corrector_contradiction(group.names, units)
        for group, units in zip(groups[1:3], stated[1:3], strict=True)
    ]
    if told := "\n".join(filter(None, wrong)):
        raise MachineError(told)
    return metres


def check_oscillator(oscillator: EpicsOscillator) -> None:
    """Refuse an RF whose frequency cannot be set, before anything moves.

    Args:
        oscillator: Connected.

    Raises:
        MachineError: Its setpoint may not be written, holds no real number, or states another
            unit than Hz.
    """
    advice = "or set rf.enabled = false, so that the loop leaves the frequency alone"
    if read_only := oscillator.group.read_only:
        raise MachineError(
            f"the RF setpoint {read_only[0]} may not be written; ask for write access for this "
            f"host and user, {advice}"
        )
    if not_real := oscillator.group.contents.not_real:
        raise MachineError(
            f"the RF setpoint cannot hold a frequency: {not_real[0]}; name another PV with "
            f"rf.setpoint_pv, {advice}"
        )
    if told := oscillator.contradiction():
        raise MachineError(f"{told}, {advice}")
    oscillator.refresh()

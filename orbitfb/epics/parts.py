"""The channels of a machine by what they are for."""

from orbitfb.core.signals import Channels
from orbitfb.core.status import ChannelCounts
from orbitfb.epics.auxiliary import AuxiliaryChannels
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.connecting import check_oscillator
from orbitfb.epics.fast_reference import SECTION, EpicsFastReference, FastFeedbackSettings
from orbitfb.epics.libca import Context
from orbitfb.epics.oscillator import EpicsOscillator
from orbitfb.epics.servers import Doubles, ServerWatch
from orbitfb.epics.setpoints.group import Setpoints
from orbitfb.epics.settings import EpicsSettings


def all_pvs(
    channels: Channels, settings: EpicsSettings, rf_pv: str, fast: FastFeedbackSettings | None
) -> tuple[str, ...]:
    """List the PVs of a machine, before there are channels; some may be empty.

    Args:
        channels: BPMs and correctors.
        settings: Has the slow channels.
        rf_pv: See `Parts`.
        fast: See `Parts`.
    """
    slow = [its.pv for its in settings.auxiliary.values()]
    references = [] if fast is None else list(fast.reference_pvs.values())
    return (*channels.pvs, *slow, rf_pv, *references)


class Parts:
    """All groups of channels.

    Args:
        context: Of the channels.
        channels: Names of the PVs.
        settings: Slow channels, and time limits.
        orbit: The BPMs.
        readbacks: Of the correctors.
        rf_pv: Setpoint of the RF frequency; empty: there is none.
        fast: A fast feedback that takes our reference; None: there is none.

    Attributes:
        setpoints: Of the correctors.
        auxiliary: Slow channels.
        oscillator: The RF, or None.
        fast_reference: Reference of the fast feedback, or None.
        origin: Key of the configuration that names a PV, where it is none of `epics`.
        groups: All, in the order in which they are opened.
        servers: Watches which servers have them.
        doubles: Hears which PVs more than one server has.
    """

    def __init__(
        self,
        context: Context,
        channels: Channels,
        settings: EpicsSettings,
        orbit: ChannelGroup,
        readbacks: ChannelGroup,
        rf_pv: str,
        fast: FastFeedbackSettings | None,
    ) -> None:
        wait = settings.answer_timeout
        self.auxiliary = AuxiliaryChannels(context, settings.auxiliary)
        self.setpoints = Setpoints(context, channels, settings)
        named = {
            "bpm": orbit,
            "setpoint": self.setpoints.group,
            "readback": readbacks,
            "auxiliary": self.auxiliary.group,
        }
        self.oscillator = EpicsOscillator(context, rf_pv, wait) if rf_pv else None
        if self.oscillator is not None:
            named["rf"] = self.oscillator.group
        self.fast_reference = (
            None if fast is None else EpicsFastReference(context, channels, fast, wait)
        )
        if self.fast_reference is not None:
            named["reference"] = self.fast_reference.group
        references = () if fast is None else fast.reference_pvs.values()
        self.origin = dict.fromkeys(references, SECTION)
        self._named = named
        self.groups = tuple(named.values())
        self.servers, self.doubles = ServerWatch(self.groups), Doubles()
        context.listeners.append(self.doubles.hear)

    @property
    def disconnected(self) -> tuple[str, ...]:
        """PVs that are away now."""
        return tuple(name for group in self.groups for name in group.disconnected)

    @property
    def total(self) -> int:
        """Count of the PVs."""
        return sum(len(group.pvs) for group in self.groups)

    def counts(self) -> tuple[ChannelCounts, ...]:
        """Count the channels of each kind, those that are connected, and those that were lost."""
        return tuple(
            ChannelCounts(kind, len(group.pvs), len(group.present), group.losses)
            for kind, group in self._named.items()
        )

    def open(self) -> None:
        """Search for all of them."""
        for group in self.groups:
            group.open()

    def check(self) -> None:
        """Refuse an RF or a fast feedback that cannot be set, before anything moves.

        Raises:
            MachineError: The message says why.
        """
        if self.oscillator is not None:
            check_oscillator(self.oscillator)
        if self.fast_reference is not None:
            self.fast_reference.check()

    def look(self) -> None:
        """Ask again for what may have changed; called every few seconds."""
        for group in self.groups:
            group.properties.end_repeating(group.lock)
        self.setpoints.refresh_limits()
        if self.oscillator is not None:
            self.oscillator.refresh()

"""The storage ring behind Channel Access, or where PVs are named so, pvAccess."""

import atexit
from collections.abc import Mapping
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import MachineError, NoOrbitError, WriteError
from orbitfb.core.ports import Clock
from orbitfb.core.signals import Applied, Channels, Mask, Orbit, Reading, Vector
from orbitfb.core.status import ChannelCounts
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.connecting import (
    UnitWatch,
    steps_of,
    wait_for_channels,
    waived,
)
from orbitfb.epics.events import Monitor
from orbitfb.epics.fast_reference import FastFeedbackSettings
from orbitfb.epics.inbox import Inbox
from orbitfb.epics.libca import Context
from orbitfb.epics.network import environment_lock, use_network
from orbitfb.epics.orbit.assembler import Assembler
from orbitfb.epics.parts import Parts, all_pvs
from orbitfb.epics.pva.provider import pva_client
from orbitfb.epics.readbacks import Readbacks
from orbitfb.epics.reconnecting import Keeper
from orbitfb.epics.settings import EpicsSettings


class EpicsMachine:
    """A machine behind Channel Access: `orbitfb.core.ports.Machine`.

    One thread reads. Any thread may write or ask for setpoints. A put is not acknowledged: one that
    the server refuses is told with the next orbit, one that it clips to its drive limits shows when
    the setpoints are asked for.

    An orbit is complete when every connected BPM carries the same stamp, so the IOC must stamp
    the BPMs of a tick alike (or within `stamp_window`) and post each of them at every tick, also
    if its value has not changed (MDEL = −1 at records of EPICS base). If several orbits come
    before they are read, the newest is returned; the gap shows in the stamps.

    Args:
        channels: Names of the PVs.
        settings: Network and time limits.
        clock: Clock of the program; its wall clock is compared with the stamps.
        counting: BPMs that are not masked, shape (n,): the others are not waited for; None: all.
        movable: Correctors that are not masked, shape (m,): of the others the setpoint alone must
            be there; None: all.
        rf_pv: Setpoint of the RF frequency, if the loop may change it; empty: it may not.
        fast: A fast feedback that takes our reference; None: there is none.

    Attributes:
        oscillator: The RF; None: the loop may not change it.
        fast_reference: Reference of the fast feedback; None: there is none.

    Raises:
        ConnectError: PVs that cannot be reached within `connect_timeout`, all of them.
        MachineError: Setpoints that may not be written, all of them; PVs that state another unit
            than the configuration; or libca fails.
    """

    def __init__(
        self,
        channels: Channels,
        settings: EpicsSettings,
        clock: Clock | None = None,
        counting: Mask | None = None,
        movable: Mask | None = None,
        rf_pv: str = "",
        fast: FastFeedbackSettings | None = None,
    ) -> None:
        self._channels = channels
        self._settings = settings
        self._clock: Clock = clock or SystemClock()
        self._closed = False
        self._orbit_assembler = Assembler(
            len(channels.orbit_pvs), settings.stamp_window, settings.stuck_bpms
        )
        if counting is not None:
            self._orbit_assembler.count(counting)
        self._readbacks = Readbacks(channels, settings.stamp_window)
        self._inbox = Inbox(
            self._orbit_assembler,
            self._readbacks.assembler,
            self._clock,
            settings,
            self._describe,
        )
        with environment_lock:
            use_network(settings)
            names = all_pvs(channels, settings, rf_pv, fast)
            self._context = Context(pva_client(settings, names))
            self._build(rf_pv, fast)
            atexit.register(self.close)
            try:
                self._parts.open()
            except MachineError:
                self.close()
                raise
        self._keeper.start()
        try:
            spared, origin = waived(channels, counting, movable), self._parts.origin
            wait_for_channels(
                self._groups, self._setpoints.group, settings, self._clock, spared, origin
            )
            self.setpoints()
            self._units = UnitWatch(self._context, self._groups, settings, channels.bpm_units)
            self._parts.check()
        except MachineError:
            self.close()
            raise

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        return self._channels

    @property
    def drive_limits(self) -> NDArray[np.float64]:
        """Drive limits that the server states, shape (m, 2), low and high [A]; NaN: none.

        Read when the setpoints connect, after they were away, and when one is not what was sent.
        """
        return self._setpoints.drive_limits

    @property
    def steps(self) -> Vector:
        """Step of each setpoint, shape (m,) [A]; 0: it holds any value."""
        return steps_of(self._setpoints.group, self._settings)

    @property
    def disconnected(self) -> tuple[str, ...]:
        """PVs that are away now."""
        return self._parts.disconnected

    @property
    def doubled(self) -> str:
        """PVs that more than one server has, in words; empty as long as none was seen."""
        return self._parts.doubles.describe()

    def servers(self) -> dict[str, int]:
        """Count the PVs of each server, `host:port`, where they were connected to last."""
        return self._parts.servers.servers()

    def channel_counts(self) -> tuple[ChannelCounts, ...]:
        """Count the channels of each kind, those that are connected, and those that were lost."""
        return self._parts.counts()

    def auxiliary_ages(self) -> Mapping[str, float]:
        """Return how old each slow channel is by its stamp [s]; NaN where nothing is known."""
        return self._parts.auxiliary.ages(self._inbox.time)

    def count_bpms(self, counting: Mask) -> None:
        """Take to heart which BPMs count for the loop: an orbit does not wait for the others.

        Args:
            counting: Shape (n,).
        """
        self._orbit_assembler.count(counting)

    def read(self, timeout: float) -> Reading:
        """Wait for the newest coherent orbit, never one that was returned before.

        Args:
            timeout: How long to wait [s].

        Raises:
            NoOrbitError: None came in time, or only stale ones; the message says what was missing.
        """
        if self._closed:
            raise NoOrbitError("the machine is closed")
        frame = self._inbox.take(timeout)
        if told := self._units.look():
            raise NoOrbitError(told)
        snapshot = frame.arrival.snapshot
        orbit = Orbit(snapshot.values * self._units.metres, snapshot.valid, snapshot.time)
        auxiliary, unknown = self._parts.auxiliary.read(self._inbox.time)
        servers = self._parts.servers
        servers.look()
        received = frame.arrival.received
        readback, behind = self._readbacks.complete(frame, self._setpoints.posted)
        return Reading(
            orbit,
            readback,
            auxiliary,
            received,
            self._setpoints.away,
            behind,
            snapshot.left_out,
            self._setpoints.errors.take(),
            unknown,
            servers.changes,
            servers.told,
            self._setpoints.watch.take(),
        )

    def setpoints(self) -> Vector:
        """Ask the machine for the absolute setpoints in force, shape (m,) [A].

        The drive limits are asked for as well, if a setpoint was away since they were, or is not
        what was sent: perhaps they have become narrower.

        Raises:
            MachineError: A setpoint does not answer with a finite value; the first are named.
            AwayError: The same, where those that do not are disconnected and others are not.
        """
        self._refuse_if_closed(MachineError)
        return self._setpoints.ask()

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Send absolute setpoints: all that are asked for, or none.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,); None: all. Nothing is put to the others.

        Raises:
            WriteError: A channel is away or read-only, or was away and has not been asked for its
                setpoint since; a value is not finite; or no orbit has come for `silent_after`
                (an IOC that hangs still looks connected).
        """
        self._refuse_if_closed(WriteError)
        values = np.array(setpoints, dtype=np.float64)
        which = np.ones(len(self._setpoints.group), dtype=np.bool_) if which is None else which
        self._setpoints.check(values, which)
        if self._units.told:
            raise WriteError(f"{self._units.told}; nothing was sent")
        if (silence := self._inbox.silence) > self._settings.silent_after:
            raise WriteError(
                f"no orbit for {silence:.1f} s: {self._describe()}; nothing was sent to a machine "
                "that may hang"
            )
        self._setpoints.put(values, which)
        return Applied(values, self._inbox.time.now(), self._clock.monotonic())

    def close(self) -> None:
        """Let go of the machine; setpoints stay where they are. May be called twice."""
        if self._closed:
            return
        self._closed = True
        atexit.unregister(self.close)
        self._keeper.stop()
        self._setpoints.group.forget()
        self._context.destroy()
        self._inbox.close()

    def __enter__(self) -> Self:
        """Return the machine itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    def _build(self, rf_pv: str, fast: FastFeedbackSettings | None) -> None:
        context, channels, settings = self._context, self._channels, self._settings
        bpms, inbox = self._orbit_assembler, self._inbox
        orbit = ChannelGroup(
            context,
            channels.orbit_pvs,
            Monitor(bpms.records, bpms.arrived, inbox.orbit_complete),
            bpms.set_connected,
            properties=True,
        )
        readbacks = self._readbacks.group(context, inbox.readbacks_complete)
        parts = self._parts = Parts(context, channels, settings, orbit, readbacks, rf_pv, fast)
        self._groups, self._setpoints = parts.groups, parts.setpoints
        self.oscillator, self.fast_reference = parts.oscillator, parts.fast_reference
        self._keeper = Keeper(context, parts.groups, settings.reconnect_period, self._after_look)

    def _after_look(self) -> None:
        self._orbit_assembler.look()
        self._readbacks.assembler.look()
        self._parts.look()

    def _refuse_if_closed(self, error: type[MachineError]) -> None:
        if self._closed:
            raise error("the machine is closed")

    def _describe(self) -> str:
        total = self._parts.total
        if self._closed:
            return "the machine is closed"
        if len(self.disconnected) == total:
            text = f"all {total} channels are disconnected"
        else:
            text = self._orbit_assembler.describe(self._channels.orbit_pvs)
        return f"{text}; {self._keeper.trouble}" if self._keeper.trouble else text

"""All setpoints as one: what is in force, how far each may go, and what is sent."""

import threading

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import AwayError, MachineError, WriteError
from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.requests import Getter, Putter
from orbitfb.epics.setpoints.put_errors import PutErrors
from orbitfb.epics.setpoints.put_watch import PutWatch
from orbitfb.epics.settings import EpicsSettings
from orbitfb.safety.bounds import ROUNDING
from orbitfb.safety.verdict import name_some


class Setpoints:
    """The setpoints of a machine behind Channel Access.

    One that was away may have come back with another value and other limits: it is not sent to
    before it was asked for both.

    Args:
        context: Context of their channels.
        channels: Names of the PVs.
        settings: Time limits.

    Attributes:
        group: Their channels.
        errors: Puts that servers refuse.
        watch: Hears what others put.
    """

    def __init__(self, context: Context, channels: Channels, settings: EpicsSettings) -> None:
        size = len(channels.setpoint_pvs)
        self.watch = PutWatch(size)
        self.group = ChannelGroup(
            context,
            channels.setpoint_pvs,
            Monitor(self.watch.records, heard=self.watch.heard),
            self._changed,
            properties=True,
        )
        self.errors = PutErrors(context, self.group)
        self._getter = Getter(context, self.group, settings.answer_timeout)
        self._putter = Putter(context, self.group)
        self._arrays = [pv for pv in self.group.pvs if pv.elements is not None]
        self._posted_at_put = np.full(size, np.nan)
        self._limits_due = True
        self._restated = 0
        self._limits_lock = threading.Lock()
        self._drive_limits = np.full((size, 2), np.nan)
        self._last = np.full(size, np.nan)
        self._comings = np.zeros(size, dtype=np.int64)
        self._unread: Mask = np.ones(size, dtype=np.bool_)

    @property
    def drive_limits(self) -> NDArray[np.float64]:
        """Drive limits that the servers state, shape (m, 2), low and high [A]; NaN: none."""
        return self._drive_limits.copy()

    @property
    def posted(self) -> Vector:
        """Setpoints as the machine posts them, shape (m,) [A]; NaN for those that are away."""
        return np.where(self.group.connected, self.watch.records["value"], np.nan)

    @property
    def away(self) -> Mask | None:
        """Those that cannot be put now, shape (m,); None: none."""
        away = ~(self.group.connected & self.group.writable)
        return away if away.any() else None

    def ask(self) -> Vector:
        """Ask for the setpoints in force, shape (m,) [A], and for drive limits if they may differ.

        Raises:
            MachineError: One does not answer with a finite value; the first are named.
            AwayError: The same, where those that do not are disconnected and others are not.
        """
        self.refresh_limits()
        comings, connected = self._comings.copy(), self.group.connected.copy()
        values = self._getter.values()
        known = np.isfinite(values)
        if (np.abs(values - self._last)[known] > ROUNDING).any():
            self._limits_due = True
            self.refresh_limits()
        self._last[known] = values[known]
        self._unread[known & (comings == self._comings)] = False
        if known.all():
            return values
        told = self._getter.describe(~known)
        if (connected & ~known).any() or not known.any():
            raise MachineError(told)
        raise AwayError(told, self._last.copy(), ~known)

    def check(self, values: Vector, which: Mask) -> None:
        """Refuse what cannot be sent, whatever the machine does.

        Args:
            values: Shape (m,) [A].
            which: Those to be put, shape (m,).

        Raises:
            WriteError: Another shape, or a value that is not finite.
        """
        expected = len(self.group)
        if values.shape != (expected,):
            raise WriteError(f"{values.shape} setpoints instead of ({expected},); nothing was sent")
        wrong = which & ~np.isfinite(values)
        if wrong.any():
            names = name_some(wrong, self.group.names)
            raise WriteError(
                f"{np.count_nonzero(wrong)} of {expected} setpoints are not finite: {names}; "
                "nothing was sent"
            )

    def put(self, values: Vector, which: Mask) -> None:
        """Send setpoints: all that are asked for, or none.

        Args:
            values: Shape (m,) [A].
            which: Those to put, shape (m,).

        Raises:
            WriteError: A channel is away or read-only, or was away and has not been asked since.
        """
        values, which = self._with_neighbours(values, which)
        if (unread := which & self.group.connected & self._unread).any():
            raise WriteError(
                f"{np.count_nonzero(unread)} of {len(values)} setpoints were away and have not "
                f"been read since: {name_some(unread, self.group.names)}; nothing was sent"
            )
        self.watch.sends(values, which)  # beforehand: the answer may be quicker than we
        self._putter.put(values, which)
        self._last = np.where(which, values, self._last)

    def _with_neighbours(self, values: Vector, which: Mask) -> tuple[Vector, Mask]:
        """Add to what is put the other elements of its arrays, as they are in force.

        What was posted last is in force if it is neither as old as our last put nor one of ours:
        then somebody else has put it. Else what we sent or were told last is.
        """
        if not self._arrays or which.all() or not which.any():
            if self._arrays:
                self._posted_at_put[:] = self.watch.records["value"]
            return values, which
        touched = which.copy()
        for pv in self._arrays:
            touched[pv.places] = which[pv.places].any()
        posted = self.watch.records["value"].copy()
        new = np.isfinite(posted) & (posted != self._posted_at_put)
        in_force = np.where(new & ~self.watch.was_sent(posted), posted, self._last)
        self._posted_at_put = posted
        sent = np.where(which, values, in_force)
        if (unknown := touched & ~np.isfinite(sent)).any():
            raise WriteError(
                f"{np.count_nonzero(unknown)} setpoints are not known, but belong to an array that "
                f"is put as a whole: {name_some(unknown, self.group.names)}; nothing was sent"
            )
        return sent, touched

    def refresh_limits(self) -> None:
        """Ask for the drive limits if they may have changed.

        They may if a setpoint was away since, is not what was sent, or says so.
        """
        with self._limits_lock:  # nobody goes on with old ones while another thread asks
            if self._restated != self.group.restated:
                self._restated, self._limits_due = self.group.restated, True
            if not self._limits_due or not self.group.connected.any():
                return
            self._limits_due = False
            here = self.group.connected.copy()
            limits = self._getter.limits()
            self._drive_limits = np.where(here[:, None], limits, self._drive_limits)

    def _changed(self, index: int, up: bool) -> None:
        self._comings[index] += 1
        self._unread[index] = True
        self._limits_due |= up
        if up:
            self.watch.came(index)

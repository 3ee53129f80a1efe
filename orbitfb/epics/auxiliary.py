"""Slow channels beside the orbit: stored current, RF frequency and what else is configured."""

from collections.abc import Mapping

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.records import INVALID, blank_records, stamps_of, usable, wall_time
from orbitfb.epics.settings import AuxiliarySettings
from orbitfb.epics.timekeeper import Timekeeper


class AuxiliaryChannels:
    """The last known value of each slow channel.

    Args:
        context: Where the channels live.
        settings: Slow channels by name.
    """

    def __init__(self, context: Context, settings: Mapping[str, AuxiliarySettings]) -> None:
        self._names = tuple(settings)
        self._limits = np.array(
            [np.inf if its.stale_after is None else its.stale_after for its in settings.values()]
        )
        self._scales = np.array([channel.scale for channel in settings.values()])
        self._records = blank_records(len(settings))
        self._stamps = np.zeros(len(settings), dtype=np.int64)
        self._born = np.full(len(settings), np.nan)
        pvs = [channel.pv for channel in settings.values()]
        self.group = ChannelGroup(context, pvs, Monitor(self._records), self.changed)

    def changed(self, index: int, up: bool) -> None:
        """Forget what a channel said before it went away.

        Args:
            index: Of the channel.
            up: Whether it has come or gone.
        """
        if not up:
            self._records["severity"][index] = INVALID

    def values(self, clock: Timekeeper) -> dict[str, float]:
        """Return the values by name, SI; NaN where disconnected, INVALID, stale or never seen.

        Args:
            clock: That of the stamps.
        """
        known = self.group.connected & usable(self._records) & self._fresh(clock)
        values = np.where(known, self._records["value"], np.nan) * self._scales
        return dict(zip(self._names, values.tolist(), strict=True))

    def unknown(self, clock: Timekeeper) -> dict[str, str]:
        """Say why values are not known, by name.

        Args:
            clock: That of the stamps.
        """
        fresh, usual, ages = self._fresh(clock), usable(self._records), self._ages_by(clock)
        if (self.group.connected & usual & fresh).all():
            return {}
        told: dict[str, str] = {}
        for index, name in enumerate(self._names):
            pv, key = self.group.names[index], f"epics.auxiliary.{name}.stale_after"
            if not self.group.connected[index]:
                told[name] = f"{pv} is away"
            elif not usual[index]:
                told[name] = f"{pv} has no valid value"
            elif not fresh[index] and np.isnan(ages[index]):
                told[name] = (
                    f"{pv} has no time stamp, so nobody can tell its age; leave {key} out if it "
                    "may count all the same"
                )
            elif not fresh[index]:
                told[name] = (
                    f"{pv} has had no new value for {ages[index]:.1f} s, more than {key} = "
                    f"{self._limits[index]:g} s; a PV that is posted on change only needs {key} = "
                    "false"
                )
        return told

    def _fresh(self, clock: Timekeeper) -> Mask:
        """Tell which values are young enough; one that may be of any age needs no stamp."""
        return np.isinf(self._limits) | (self._ages_by(clock) <= self._limits)

    def ages(self, clock: Timekeeper) -> dict[str, float]:
        """Return the age of each value by name [s]; NaN where never seen.

        Args:
            clock: That of the stamps.
        """
        return dict(zip(self._names, self._ages_by(clock).tolist(), strict=True))

    def _ages_by(self, clock: Timekeeper) -> Vector:
        """Tell the age of a stamp when it is first seen, and let it grow by the monotonic clock.

        So a clock that is set does not make old what has not come anew since.
        """
        stamps, now = stamps_of(self._records), clock.monotonic()
        for index in np.flatnonzero(stamps != self._stamps):
            stamp = int(stamps[index])
            self._stamps[index] = stamp
            self._born[index] = now - clock.age(wall_time(stamp)) if stamp else np.nan
        return now - self._born

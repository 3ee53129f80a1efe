"""Slow channels beside the orbit: stored current, RF frequency and what else is configured."""

from collections.abc import Mapping

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.orbit.timekeeper import Timekeeper
from orbitfb.epics.records import INVALID, blank_records, stamps_of, usable, wall_time
from orbitfb.epics.settings import AuxiliarySettings


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
        self._ageless = np.isinf(self._limits)  # one that may be of any age needs no stamp
        self._scales = np.array([channel.scale for channel in settings.values()])
        self._records = blank_records(len(settings))
        self._stamps = np.zeros(len(settings), dtype=np.int64)
        self._born = np.full(len(settings), np.nan)
        self._ahead = np.zeros(len(settings))  # of our clock, when the stamp was first seen [s]
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

    def read(self, clock: Timekeeper) -> tuple[dict[str, float], dict[str, str]]:
        """Give the values, and say why some are not known.

        Args:
            clock: That of the stamps.

        Returns:
            Values by name, SI, NaN where disconnected, INVALID, stale or never seen; and why not,
            by name, for those.
        """
        here, usual = self.group.connected.copy(), usable(self._records)
        ages = self._ages_by(clock)
        fresh = self._ageless | ((ages <= self._limits) & (self._ahead <= self._limits))
        known = here & usual & fresh
        values = np.where(known, self._records["value"], np.nan) * self._scales
        told = {} if known.all() else self._unknown(here, usual, fresh, ages)
        return dict(zip(self._names, values.tolist(), strict=True)), told

    def _unknown(self, here: Mask, usual: Mask, fresh: Mask, ages: Vector) -> dict[str, str]:
        told: dict[str, str] = {}
        for index, name in enumerate(self._names):
            pv, key = self.group.names[index], f"epics.auxiliary.{name}.stale_after"
            if not here[index]:
                told[name] = f"{pv} is away"
            elif not usual[index]:
                told[name] = f"{pv} has no valid value"
            elif not fresh[index] and np.isnan(ages[index]):
                told[name] = (
                    f"{pv} has no time stamp, so nobody can tell its age; leave {key} out if it "
                    "may count all the same"
                )
            elif not fresh[index] and self._ahead[index] > self._limits[index]:
                told[name] = (
                    f"{pv} was stamped {self._ahead[index]:.1f} s in the future, more than {key} = "
                    f"{self._limits[index]:g} s: nobody can tell its age; set the clocks"
                )
            elif not fresh[index]:
                told[name] = (
                    f"{pv} has had no new value for {ages[index]:.1f} s, more than {key} = "
                    f"{self._limits[index]:g} s; a PV that is posted on change only needs {key} = "
                    "false"
                )
        return told

    def ages(self, clock: Timekeeper) -> dict[str, float]:
        """Return the age of each value by name [s]; NaN where never seen.

        Args:
            clock: That of the stamps.
        """
        return dict(zip(self._names, self._ages_by(clock).tolist(), strict=True))

    def _ages_by(self, clock: Timekeeper) -> Vector:
        """Tell the age of a stamp when it is first seen, and let it grow by the monotonic clock.

        So a clock that is set does not make old what has not come anew since. A stamp in the
        future counts from when it was seen, if it is no further ahead than the value may be old: a
        clock that is ahead keeps nothing young.
        """
        stamps, now = stamps_of(self._records), clock.monotonic()
        for index in np.flatnonzero(stamps != self._stamps):
            stamp = int(stamps[index])
            self._stamps[index] = stamp
            age = clock.age(wall_time(stamp)) if stamp else np.nan
            self._born[index], self._ahead[index] = now - max(age, 0.0), -min(age, 0.0)
        return now - self._born

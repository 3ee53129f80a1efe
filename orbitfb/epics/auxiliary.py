"""Slow channels beside the orbit: stored current, RF frequency and what else is configured."""

from collections.abc import Mapping

import numpy as np

from orbitfb.epics.channels import ChannelGroup, Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.records import (
    EPICS_EPOCH,
    NANOSECONDS,
    blank_records,
    stamps_of,
    usable,
    wall_time,
)
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
        self._scales = np.array([channel.scale for channel in settings.values()])
        self._records = blank_records(len(settings))
        pvs = [channel.pv for channel in settings.values()]
        self.group = ChannelGroup(context, pvs, Monitor(self._records))

    def values(self, now: float) -> dict[str, float]:
        """Return the values by name, SI; NaN where disconnected, INVALID, stale or never seen.

        Args:
            now: Wall clock [s since the epoch].
        """
        ages = now - EPICS_EPOCH - stamps_of(self._records) / NANOSECONDS
        known = self.group.connected & usable(self._records) & (ages <= self._limits)
        values = np.where(known, self._records["value"], np.nan) * self._scales
        return dict(zip(self._names, values.tolist(), strict=True))

    def ages(self, now: float) -> dict[str, float]:
        """Return the age of each stamp by name [s]; NaN where never seen.

        Args:
            now: Wall clock [s since the epoch].
        """
        stamps = stamps_of(self._records).tolist()
        return {
            name: now - wall_time(stamp) if stamp else float("nan")
            for name, stamp in zip(self._names, stamps, strict=True)
        }

"""EPICS time stamps: whole seconds since 1990 and nanoseconds."""

import time
from typing import NamedTuple

EPICS_EPOCH = 631152000
"""1990-01-01T00:00:00Z [s since 1970]."""


class Stamp(NamedTuple):
    """A moment, exact to the nanosecond."""

    seconds: int
    nanoseconds: int


def now() -> Stamp:
    """Read the wall clock."""
    seconds, nanoseconds = divmod(time.time_ns(), 1_000_000_000)
    return Stamp(seconds - EPICS_EPOCH, nanoseconds)

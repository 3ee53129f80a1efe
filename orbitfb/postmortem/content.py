"""How a post-mortem lies in its file: names, types, limits. Writer and reader share it."""

from collections.abc import Iterable

import numpy as np

from orbitfb.core.signals import Channels
from orbitfb.history.columns import Layout, layout

SCHEMA_VERSION = 1
"""Version of the files; another one is refused."""

PHASES = ("read", "check", "decide", "limit", "act")
"""Columns of `phases`."""

ABOUT, CONFIGURATION = "about", "configuration"
MORE = "more/"
"""What the names of datasets begin with that hold whatever else a record has."""

LONGEST_TEXT = 1 << 20
"""Of the configuration, and of what the file says of itself [bytes]."""
LONGEST_REASON = 1024
LONGEST_EVENT = 4096
LONGEST_NAME = 256
MOST_ROWS = 200_000
MOST_NAMES = 100_000

MARGIN_UNITS = {"since_trip": "s", "ended": "s", "phases": "s", "reason": "1"}
"""Units of the columns that the archive does not have."""


def plan(channels: Channels, auxiliary: Iterable[str]) -> Layout:
    """Describe the columns: those of the archive, and four of our own.

    Args:
        channels: The names behind the vectors.
        auxiliary: Names of slow channels.
    """
    real = np.dtype("<f8")
    return layout(channels, auxiliary) | {
        "since_trip": (real, ()),
        "ended": (real, ()),
        "phases": (real, (len(PHASES),)),
        "reason": (np.dtype("<i4"), ()),
    }

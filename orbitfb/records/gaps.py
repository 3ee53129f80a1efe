"""The gaps of insertion devices among the channels of a record."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.records.record import Record


def is_gap(name: str) -> bool:
    """Whether a channel is the gap of an insertion device [m], by its name."""
    return "gap" in name.lower()


def gaps_of(record: Record) -> dict[str, Vector]:
    """The channels whose name speaks of a gap, in the order of their names.

    Args:
        record: Whose auxiliary channels are looked at.
    """
    return {
        name: values
        for name, values in sorted(record.auxiliary.items())
        if is_gap(name) and np.all(np.isfinite(values))
    }

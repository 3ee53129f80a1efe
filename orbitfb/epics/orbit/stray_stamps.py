"""Channels that do not carry the stamp of the others, tick after tick.

A BPM that sends nothing, whose clock is 1 ms ahead, or that delivers every reading one period late,
would keep every orbit from being complete. The stamp of a tick is that of the largest group of
channels; a channel that is outside this group at two ticks in a row strays.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Mask
from orbitfb.epics.records import NANOSECONDS

Stamps = NDArray[np.int64]


def common_stamp(stamps: Stamps, window: int) -> int:
    """Return the newest stamp of the largest group [ns], the newest group among equals.

    Args:
        stamps: At least one, shape (k,) [ns].
        window: How far the stamps of one group may lie apart [ns].
    """
    ordered = np.sort(stamps)
    upto = np.searchsorted(ordered, ordered, side="right")
    sizes = upto - np.searchsorted(ordered, ordered - window, side="left")
    return int(ordered[np.flatnonzero(sizes == sizes.max())[-1]])


def outside(stamps: Stamps, common: int, window: int) -> Mask:
    """Tell which stamps are not in the group that ends with the common one, shape (k,)."""
    return (stamps > common) | (stamps < common - window)


class StrayStamps:
    """Remembers who was outside the group at the tick before.

    Args:
        size: Count of channels n.
        window: How far the stamps of one orbit may lie apart [ns].

    Attributes:
        suspects: Outside the group at the last tick that was looked at, shape (n,).
        offsets: Stamp of each less that of the group when it became a suspect, shape (n,) [ns].
    """

    def __init__(self, size: int, window: int) -> None:
        self.suspects: Mask = np.zeros(size, dtype=np.bool_)
        self.offsets: Stamps = np.zeros(size, dtype=np.int64)
        self._window = window
        self._at = 0

    def find(self, stamps: Stamps, among: Mask, published: int) -> Mask:
        """Find the channels that are outside the group for the second tick, shape (n,).

        Args:
            stamps: Of all channels, shape (n,) [ns].
            among: Channels to look at, shape (n,); at least one.
            published: Stamp of the last orbit [ns]: a group that is no newer tells nothing.
        """
        none = np.zeros_like(among)
        common = common_stamp(stamps[among], self._window)
        if common <= published:
            return none
        odd = among & outside(stamps, common, self._window)
        if 2 * np.count_nonzero(odd) >= np.count_nonzero(among):
            return none  # there is no group that most belong to
        before, self.suspects = self.suspects, odd
        self.offsets = np.where(odd & ~before, stamps - common, self.offsets)
        if common == self._at:
            return none
        self._at = common
        return odd & before

    def clear(self) -> None:
        """Suspect nobody: the orbit was complete."""
        self.suspects = np.zeros_like(self.suspects)


def difference(offset: int) -> str:
    """Say how far a stamp is from that of the others.

    Args:
        offset: The one less the other [ns].
    """
    seconds = abs(offset) / NANOSECONDS
    told = f"{seconds:.3g} s" if seconds >= 1.0 else f"{1e3 * seconds:.3g} ms"
    return f"stamped {told} {'ahead of' if offset > 0 else 'behind'} the others"

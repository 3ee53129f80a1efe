"""The orbit error of each plane: that of the last orbit, and its mean squares over a window."""

import math
from collections.abc import Mapping

from orbitfb.core.signals import Orbit, Vector
from orbitfb.observe.statistics.windows import Window


class PlaneErrors:
    """The rms orbit error of each plane.

    Args:
        parts: Slice of the BPMs of each plane.
        window: Length of the window [s].
    """

    def __init__(self, parts: Mapping[str, slice], window: float) -> None:
        self._parts = parts
        self._windows = {plane: Window(window) for plane in parts}
        self._last = dict.fromkeys(parts, math.nan)

    def add(self, orbit: Orbit, reference: Vector, stamp: float) -> float:
        """Take an orbit and return the mean square error of all valid BPMs [m²].

        Args:
            orbit: Shape (n,) [m].
            reference: Reference orbit, shape (n,) [m].
            stamp: Its time [s since the epoch].
        """
        error = orbit.position - reference
        total, count = 0.0, 0
        for plane, part in self._parts.items():
            valid = error[part][orbit.valid[part]]
            squares = float(valid @ valid)
            mean = squares / valid.size if valid.size else math.nan
            self._last[plane] = math.sqrt(mean)
            self._windows[plane].add(stamp, mean)
            total += squares
            count += valid.size
        return total / count if count else math.nan

    def forget_last(self) -> None:
        """Take note that no orbit came."""
        self._last = dict.fromkeys(self._parts, math.nan)

    def copy(self) -> dict[str, tuple[float, list[tuple[float, float]]]]:
        """Copy the last rms error of each plane [m], and its window of mean squares [m²]."""
        return {plane: (self._last[plane], its.copy()) for plane, its in self._windows.items()}

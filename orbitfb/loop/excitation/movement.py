"""A planned movement of the setpoints, once: what a diagnosis asks for, beside the feedback.

It is an excursion around the setpoints of the feedback, as the dither is, and logged in the same
column: row k of the waveform is where the setpoints stand around the feedback's in the k-th tick.
"""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.loop.excitation.dither import Dither


class Progress(StrEnum):
    """How far an excitation is."""

    WAITING = "waiting"
    """The loop is not closed, or not long enough."""
    RUNNING = "running"
    DONE = "done"
    ABANDONED = "abandoned"
    """The loop tripped or was opened in the middle; it is not taken up again."""


@dataclass(frozen=True, slots=True, eq=False)
class Waveform:
    """What to do.

    Args:
        excursion: Shape (T, m) [A].
        wait: Ticks in CLOSED before it begins.
    """

    excursion: NDArray[np.float64]
    wait: int


class Excitation(Dither):
    """A waveform, once, and a dither below it.

    A loop that was HELD for a while goes on with the rest; one that tripped or was opened by
    command does not: an operator wanted it to stop, or an interlock did.

    Args:
        waveform: What to do; checked against the limits.
        dither: Goes on all the time.
    """

    def __init__(self, waveform: Waveform, dither: Dither) -> None:
        self._waveform, self._dither = waveform, dither
        self._own = np.zeros(waveform.excursion.shape[1])
        self._asked = (self._own, self._own)
        self._waited = self._row = 0
        self._progress = Progress.WAITING

    @property
    def progress(self) -> Progress:
        """How far it is."""
        return self._progress

    @property
    def rows(self) -> int:
        """Rows of the waveform that were written."""
        return min(self._row, len(self._waveform.excursion))

    @property
    def amplitude(self) -> float:
        """Rms excursion of a corrector by the dither below [A]."""
        return self._dither.amplitude

    @property
    def excursion(self) -> Vector:
        """Where the setpoints stand around those of the feedback, shape (m,) [A]."""
        return self._dither.excursion + self._own

    def propose(self, question: Vector | None = None) -> Vector:
        """Return the next change, shape (m,) [A]: of the waveform and of the dither.

        Args:
            question: Another excursion to add to it, shape (m,) [A]; None: none.
        """
        below = self._dither.propose(question)
        own = np.zeros_like(self._own)
        if self._progress is Progress.WAITING and self._waited >= self._waveform.wait:
            self._progress = Progress.RUNNING
        if self._progress is Progress.RUNNING:
            rows = self._waveform.excursion
            own = (rows[self._row] if self._row < len(rows) else 0.0) - self._own
        self._asked = (below, own)
        return below + own

    def settle(self, change: Vector) -> None:
        """Note the part of a proposed change that was written, shape (m,) [A]."""
        below, own = self._asked
        asked = below + own
        size = float(asked @ asked)
        share = float(change @ asked) / size if size else 1.0
        self._dither.settle(share * below)
        self._own = self._own + share * own
        if self._progress is Progress.WAITING:
            self._waited += 1
        elif self._progress is Progress.RUNNING:
            self._row += 1
            if self._row > len(self._waveform.excursion):
                self._progress = Progress.DONE

    def restart(self, held: bool = False) -> None:
        """Take the setpoints as they are for those of the feedback.

        Args:
            held: Whether the loop was only HELD; else a waveform that has begun is abandoned.
        """
        self._dither.restart(held)
        self._own = np.zeros_like(self._own)
        if not held and self._progress is Progress.RUNNING:
            self._progress = Progress.ABANDONED
        self._waited = self._waited if held else 0

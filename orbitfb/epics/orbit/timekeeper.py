"""What time it is at the IOCs, though somebody sets a clock: ours, theirs or both at once.

Ages are told from stamps, and stamps are wall clock. A wall clock may be set at any moment; an age
that is told from two of them is then wrong by the step, and a fresh orbit looks hours old. So the
wall clock as it was is carried on by the monotonic one, and a stamp is as old as the one of the
two says by which it is younger: a stamp is old only if it is by both.
"""

from orbitfb.core.ports import Clock


class Timekeeper:
    """The wall clock, and what it would show had nobody set it.

    Args:
        clock: Clock of the program.
        agrees: Age of an orbit up to which the wall clock agrees with the stamps [s].
    """

    def __init__(self, clock: Clock, agrees: float) -> None:
        self._clock, self._agrees = clock, agrees
        self._offset = clock.wall() - clock.monotonic()

    def monotonic(self) -> float:
        """Return the monotonic time [s]."""
        return self._clock.monotonic()

    def now(self) -> float:
        """Return the time by the clock of the stamps [s since the epoch]."""
        return self._offset + self._clock.monotonic()

    def age(self, stamp: float) -> float:
        """Say how old a stamp is [s]; negative: in the future.

        Args:
            stamp: [s since the epoch].
        """
        return min(self.now() - stamp, self._clock.wall() - stamp, key=abs)

    def follow(self, stamp: float) -> None:
        """Take the wall clock for right if it agrees with a fresh orbit.

        Args:
            stamp: Of that orbit [s since the epoch].
        """
        wall = self._clock.wall()
        if abs(wall - stamp) <= self._agrees:
            self._offset = wall - self._clock.monotonic()

"""Tells what the loop does to the RF frequency: every stop at once, steps once a minute at most."""

from collections.abc import Callable

import structlog

from orbitfb.core.ports import Clock
from orbitfb.core.signals import TickRecord
from orbitfb.loop.frequency import Sight

_log = structlog.stdlib.get_logger("orbitfb.service")

QUIET = 60.0
"""Shortest time between two lines about steps [s]."""


class RfNews:
    """A subscriber of the loop.

    Args:
        sight: Gives how the frequency is.
        clock: Tells the time.
        tell: Gets a line for people when the loop lets go of the frequency, or takes it again.
    """

    def __init__(
        self, sight: Callable[[], Sight], clock: Clock, tell: Callable[[str], None]
    ) -> None:
        self._sight, self._clock, self._tell = sight, clock, tell
        self._following, self._steps, self._told = True, 0, -QUIET

    def __call__(self, record: TickRecord) -> None:
        """Look at a tick."""
        sight = self._sight()
        if sight.following is not self._following:
            self._following = sight.following
            if sight.following:
                _log.info("rf_follows", frequency=sight.frequency)
                self._tell("the frequency follows the energy again")
            else:
                _log.warning("rf_stopped", reason=sight.reason, frequency=sight.frequency)
                self._tell(f"the RF frequency is not adjusted: {sight.reason}")
        now = self._clock.monotonic()
        if sight.steps > self._steps and now - self._told >= QUIET:
            _log.info(
                "rf_stepped",
                frequency=sight.frequency,
                last_step=sight.last_step,
                steps=sight.steps - self._steps,
                energy=sight.energy,
            )
            self._steps, self._told = sight.steps, now

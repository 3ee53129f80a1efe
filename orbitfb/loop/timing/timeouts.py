"""Time-outs that must fit the rate of the loop: at 0.1 Hz an orbit is 10 s old before the next.

A time-out that nobody set follows the rate. One that somebody set too short is refused: the loop
would hold, or refuse to write, though nothing is wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass

from orbitfb.loop.settings import LoopSettings

LATE_AND_LOST = 3.0
"""Periods without an orbit that are no silence yet: one orbit may be lost, the next one late."""


@dataclass(frozen=True, slots=True)
class TimeoutRule:
    """What a time-out must exceed, or stay below, at a rate.

    Args:
        key: Dotted key of the configuration.
        bound: Value that a time-out that was set must be beyond [s].
        usual: Value of one that was not set, if its default does not fit [s].
        why: What the bound is.
        below: Whether the value must be below the bound, not above it.
    """

    key: str
    bound: Callable[[LoopSettings], float]
    usual: Callable[[LoopSettings], float]
    why: str
    below: bool = False

    def fitted(self, value: float, given: bool, loop: LoopSettings) -> float:
        """Give the value in force [s]; NaN where the one that was set does not fit.

        Args:
            value: As configured, or the default [s].
            given: Whether somebody set it.
            loop: Has the rate.
        """
        pick, bound = (min, self.bound(loop)) if self.below else (max, self.bound(loop))
        if not given:
            return pick(value, self.usual(loop))
        fits = value < bound if self.below else value > bound
        return value if fits else float("nan")

    def refusal(self, value: float, loop: LoopSettings) -> str:
        """Say why a value does not fit and which would.

        Args:
            value: As configured [s].
            loop: Has the rate.
        """
        beyond = "below" if self.below else "above"
        return (
            f"{self.key} = {value:g} s does not fit loop.rate_hz = {loop.rate_hz:g}: it must be "
            f"{beyond} {self.bound(loop):.4g} s, {self.why}; {self.usual(loop):.4g} s fits"
        )


RULES = (
    TimeoutRule(
        "epics.silent_after",
        lambda loop: loop.period,
        lambda loop: LATE_AND_LOST * loop.period,
        "the period of the loop",
    ),
    TimeoutRule(
        "observe.stale_after",
        lambda loop: loop.patience,
        lambda loop: loop.patience + loop.period,
        "the time that a tick may wait for its orbit (loop.hold_after periods)",
    ),
    TimeoutRule(
        "loop.trip_after",
        lambda loop: loop.proving * loop.period,
        lambda loop: 2.0 * loop.proving * loop.period,
        "the time that a held loop needs for its good orbits (loop.proving)",
    ),
    TimeoutRule(
        "epics.stamp_window",
        lambda loop: loop.period / 2,
        lambda loop: loop.period / 4,
        "half a period: readings of two ticks would be taken for one orbit",
        below=True,
    ),
)
"""Every time-out that depends on the rate."""

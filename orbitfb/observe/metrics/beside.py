"""What a scrape tells beside the loop's own figures."""

import math
from collections.abc import Callable
from dataclasses import dataclass

from orbitfb.core.status import ChannelCounts
from orbitfb.loop.frequency import Sight
from orbitfb.observe.last_diagnosis import DiagnosisFigures
from orbitfb.safety.believed import Believed


@dataclass(frozen=True, slots=True)
class Beside:
    """Where the rest comes from; each function is called once per scrape.

    Args:
        channels: Counts the channels to the machine.
        dither_cost: Orbit motion that the dither may cause, rms [m].
        diagnosis: Figures of the last diagnosis, if there is one.
        period: Time between two ticks as configured [s]; NaN: not known.
        noise: Noise of one BPM reading to believe before a refit has found it, rms [m].
        most_invalid: Invalid BPMs above which the loop is HELD.
        clock_steps: Counts how often a clock was set.
        believed: Tells what was asked of the ring, and which ticks it answered.
        unsaved: Whether settings of operators are in force that could not be saved yet.
        rf: Gives how the RF frequency is.
    """

    channels: Callable[[], tuple[ChannelCounts, ...]] = tuple
    dither_cost: Callable[[], float] = lambda: math.nan
    diagnosis: Callable[[], DiagnosisFigures | None] = lambda: None
    period: float = math.nan
    noise: float = math.nan
    most_invalid: float = math.nan
    clock_steps: Callable[[], int] = int
    unsaved: Callable[[], bool] = bool
    believed: Callable[[], Believed] = Believed
    rf: Callable[[], Sight] = Sight

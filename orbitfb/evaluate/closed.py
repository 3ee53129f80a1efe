"""The closed loop of the experiments that go through Channel Access: a ring of its own, a runner.

Every law gets a soft IOC in a child process and a loop that closes by itself, with the limits and
interlocks of operation and a reference of zero. As in operation, the others take over from a
corrector at its limit; there is no baseline that would decide in a law's place.
"""

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

from orbitfb.core.clock import SystemClock
from orbitfb.core.ports import Clock, Subscriber
from orbitfb.core.signals import Channels, LoopState
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.guard import Safeguards
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.policies.masking import without
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

_SLACK = 0.3
"""How long the loop waits for an orbit before it holds [s]: the clock is the computer's own."""


def accelerated(rate_hz: float) -> LoopSettings:
    """Give the settings of a loop on a clock faster than the machine's.

    Args:
        rate_hz: Ticks per second [Hz].
    """
    return LoopSettings(rate_hz=rate_hz, hold_after=max(1.9, _SLACK * rate_hz))


def closed_loop(
    channels: Channels,
    network: EpicsSettings,
    slot: PolicySlot,
    loop: LoopSettings,
    subscribers: Sequence[Subscriber],
    stack: ExitStack,
) -> Runner:
    """Make a loop that starts CLOSED.

    Args:
        channels: Of the ring.
        network: Where it is served.
        slot: Where the policy in force lies.
        loop: Pacing and holding.
        subscribers: Get every record.
        stack: Lets go of the ring.

    Raises:
        OrbitFeedbackError: The ring cannot be reached.
    """
    clock: Clock = SystemClock()
    machine = stack.enter_context(EpicsMachine(channels, network, clock))
    return Runner(
        machine,
        slot,
        loop,
        LimitSettings(),
        InterlockSettings(answer_reach=None),  # simulated: it answers, and runs can be repeated
        np.zeros(len(channels.bpms)),
        clock,
        start=LoopState.CLOSED,
        subscribers=subscribers,
        safeguards=Safeguards(without=without),
    )

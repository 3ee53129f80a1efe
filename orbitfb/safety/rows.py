"""Rows of a record during which a corrector did not follow: they must not teach anybody."""

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.core.transitions import Transitions
from orbitfb.safety.interlocks import InterlockSettings


def astray(transitions: Transitions, settings: InterlockSettings) -> Mask:
    """Find the rows whose orbit some corrector spoils.

    A corrector that does not follow tells nothing of what its setpoint does, and in the moment in
    which it fails or comes back it moves the orbit by something that nobody asked for.

    Args:
        transitions: T transitions.
        settings: Tolerance and lag of the readbacks.

    Returns:
        Shape (T,): a corrector was moved that did not follow then or just after, or one began or
        ceased to follow.
    """
    refused = np.zeros(len(transitions), dtype=np.bool_)
    if settings.readback_tolerance is None or not len(transitions):
        return refused
    low = high = transitions.setpoints
    for lag in range(1, settings.readback_lag + 1):
        earlier = np.concatenate((np.repeat(low[:1], lag, axis=0), transitions.setpoints[:-lag]))
        earlier = earlier[: len(transitions)]
        low, high = np.minimum(low, earlier), np.maximum(high, earlier)
    tolerance, readback = settings.readback_tolerance, transitions.readback
    off = ~((readback >= low - tolerance) & (readback <= high + tolerance))
    if not off.any():
        return refused
    turned = np.zeros_like(refused)
    turned[1:] = (off[1:] != off[:-1]).any(axis=1)
    soon_off, soon_turned = off.copy(), turned.copy()
    for later in range(1, settings.readback_lag + settings.readback_ticks):
        soon_off[:-later] |= off[later:]
        soon_turned[:-later] |= turned[later:]
    return (soon_off & (transitions.applied != 0.0)).any(axis=1) | soon_turned

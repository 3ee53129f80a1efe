"""Broken devices, and the rows that the learner must leave out because of them.

A corrector that is stuck or has the wrong sign is not a drift of R, and a refit must not fit it as
one. Readings of a broken BPM do not count. If a broken corrector was moved, its true kick is
unknown, and the learner leaves the row out.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from orbitfb.core.gap import GapSight
from orbitfb.core.signals import Channels, Mask
from orbitfb.core.transitions import Transitions
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.rows import astray

BREAKING = frozenset(
    {
        "bpm-stuck",
        "bpm-polarity",
        "bpm-swap",
        "corrector-stuck",
        "corrector-polarity",
        "corrector-swap",
        "corrector-saturation",
    }
)
"""Effects after which the learner cannot use a device at all."""
SURE = 0.9
"""Probability from which a device counts as broken [1]."""


@dataclass(frozen=True, slots=True)
class Broken:
    """A device that is broken.

    Args:
        effect: Id of the effect.
        name: Name of the device.
        planes: Planes that are affected.
        since: Onset [s since the epoch]; −inf: always.
    """

    effect: str
    name: str
    planes: str
    since: float = -np.inf


class Source(Protocol):
    """A store of the last transitions."""

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions: the last ones, or those since a tick."""
        ...


def broken_at_sight(sight: GapSight) -> tuple[Broken, ...]:
    """List the broken devices that a look at the last ticks found."""
    if not sight.resolved or sight.effect not in BREAKING or sight.probability < SURE:
        return ()
    return tuple(
        Broken(sight.effect, name, plane, sight.since)
        for name, plane in zip(sight.places, sight.planes, strict=True)
    )


def broken_rows(broken: Sequence[Broken], transitions: Transitions, channels: Channels) -> Mask:
    """Find the rows that the learner must leave out.

    Args:
        broken: The devices.
        transitions: T transitions.
        channels: Channels of the ring.

    Returns:
        Shape (T,): true where a broken corrector was moved.
    """
    refused = np.zeros(len(transitions), dtype=np.bool_)
    for device in broken:
        columns = _columns(device, channels.correctors, channels)
        moved = (transitions.applied[:, columns] != 0.0).any(axis=1)
        refused |= moved & (transitions.time >= device.since)
    return refused


def screened(transitions: Transitions, broken: Sequence[Broken], channels: Channels) -> Transitions:
    """Mark rows of broken correctors unusable, and readings of broken BPMs invalid."""
    if not broken:
        return transitions
    valid = transitions.valid.copy()
    for device in broken:
        late = transitions.time >= device.since
        for column in _columns(device, channels.bpms, channels):
            valid[late, column] = False
    usable = transitions.usable & ~broken_rows(broken, transitions, channels)
    return replace(transitions, valid=valid, usable=usable)


class Screen:
    """The history without the rows and readings of broken devices, for the learner.

    Args:
        history: The last transitions.
        channels: Channels of the ring.
        broken: Returns the devices that are broken now.
        interlocks: Limits beyond which a corrector does not follow its setpoint; None: not checked.
    """

    def __init__(
        self,
        history: Source,
        channels: Channels,
        broken: Callable[[], Sequence[Broken]],
        interlocks: InterlockSettings | None = None,
    ) -> None:
        self._history, self._channels, self._broken = history, channels, broken
        self._interlocks = interlocks

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions, screened."""
        transitions = self._history.snapshot(last, since_tick)
        if self._interlocks is not None and len(transitions):
            refused = astray(transitions, self._interlocks)
            transitions = replace(transitions, usable=transitions.usable & ~refused)
        return screened(transitions, self._broken(), self._channels)


def _columns(device: Broken, names: tuple[str, ...], channels: Channels) -> list[int]:
    planes = channels.bpm_planes if names is channels.bpms else channels.corrector_planes
    return [
        column
        for column, (name, plane) in enumerate(zip(names, planes, strict=True))
        if name == device.name and plane in device.planes
    ]

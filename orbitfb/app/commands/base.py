"""What the adjustments of a running loop start from."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orbitfb.core.signals import Channels, Mask, Vector
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Ring


@dataclass(frozen=True, slots=True)
class Base:
    """What the adjustments start from.

    Args:
        channels: Of the loop.
        counting: BPMs that are not masked by configuration, shape (n,).
        movable: Correctors that are not, shape (m,).
        limits: Of what operators may set.
        directory: Data directory.
        ring: For bumps.
        crossed: Says which correctors would go beyond their limits with a change of the setpoints,
            shape (m,) [A]; empty: none.
    """

    channels: Channels
    counting: Mask
    movable: Mask
    limits: PanelSettings
    directory: Path
    ring: Ring
    crossed: Callable[[Vector], str] = lambda change: ""

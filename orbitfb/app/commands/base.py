"""What the adjustments of a running loop start from, and what they must keep."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbitfb.app.commands.arguments import reference_of
from orbitfb.core.errors import ControlError
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

    def check_enabled(self, bpms: Mask, correctors: Mask) -> None:
        """Refuse to disable all devices.

        Args:
            bpms: BPMs that are to be enabled, shape (n,).
            correctors: Correctors that are to be enabled, shape (m,).

        Raises:
            ControlError: No BPM or no corrector would be left.
        """
        if not (bpms & self.counting).any() or not (correctors & self.movable).any():
            raise ControlError("at least one BPM and one corrector must stay enabled")

    def reference(self, values: Sequence[Any]) -> Vector:
        """Check a reference orbit, shape (n,) [m].

        Raises:
            ControlError: It has another length, is not finite, or goes beyond its limit.
        """
        return reference_of(values, len(self.channels.bpms), self.limits.reference_limit)

"""What operators may change while the loop runs, as one value that it takes between two ticks.

Nothing of it moves a setpoint by itself: setpoints are absolute and each tick adds a change to
them, so that another gain or other devices act on the next change alone. The reference is the
exception, as the loop follows it: while it writes, the reference moves at a limited speed.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Channels, Mask, Vector


@dataclass(frozen=True, slots=True)
class Adjustments:
    """What operators want.

    Args:
        gain: Factor of the policy's change, shape (m,) [1].
        reference: Reference orbit to go to, shape (n,) [m].
        enabled: BPMs that count as far as operators say, shape (n,).
        average: Orbits that are averaged for a correction.
        dead_band: Rms orbit error of each plane up to which it is left alone [m]; empty: 0.
    """

    gain: Vector
    reference: Vector
    enabled: Mask
    average: int = 1
    dead_band: tuple[float, ...] = ()

    @classmethod
    def none(cls, reference: Vector, correctors: int) -> Self:
        """Give those of a loop that nobody has adjusted.

        Args:
            reference: Shape (n,) [m].
            correctors: m.
        """
        return cls(np.ones(correctors), reference, np.ones(len(reference), dtype=np.bool_))

    def check(self, channels: Channels) -> None:
        """See whether they fit a machine.

        Args:
            channels: Of the machine.

        Raises:
            ControlError: One of them does not.
        """
        n, m, bands = (len(channels.bpms),), (len(channels.correctors),), self.dead_band
        shapes = self.gain.shape, self.reference.shape, self.enabled.shape
        finite = np.isfinite(self.gain).all() and np.isfinite(self.reference).all()
        finite &= len(bands) in (0, len(channels.planes)) and all(band >= 0 for band in bands)
        if shapes != (m, n, n) or not finite or (self.gain < 0).any() or self.average < 1:
            raise ControlError("adjustments of another machine, or not finite; nothing was changed")


def approach(now: Vector, aim: Vector, step: float) -> Vector:
    """Move a reference towards another one, straight, without changing its shape on the way.

    Args:
        now: Shape (n,) [m].
        aim: Shape (n,) [m].
        step: Largest movement of any element [m].

    Returns:
        The next reference; `aim` itself once it is reached.
    """
    if now is aim:
        return aim
    way = aim - now
    largest = float(np.abs(way).max(initial=0.0))
    if largest <= step:
        return aim
    return now + step / largest * way

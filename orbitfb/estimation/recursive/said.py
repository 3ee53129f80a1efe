"""What a reading says, to the estimate and to whoever makes a gain of it."""

from dataclasses import dataclass

from orbitfb.core.signals import Vector


@dataclass(frozen=True, slots=True)
class Filtered:
    """Where a reading says that the orbit is; R as it was known before.

    Args:
        expected: The orbit at the next tick if nothing is changed, in modes, shape (n,) [m].
        deviation: Its norm over what noise alone makes expect [1].
    """

    expected: Vector
    deviation: float


@dataclass(frozen=True, slots=True)
class Innovation:
    """What a reading said.

    Args:
        chi2: Mean squared innovation over its predicted variance; 1 when all is right.
        doubt: What not knowing R adds to the variance of the innovation, over what that is when
            R is known; mean over the modes [1].
        kick: Whether the reading was taken for a kick, of which R learns nothing.
    """

    chi2: float
    doubt: float
    kick: bool

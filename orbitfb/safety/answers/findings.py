"""What is looked at for answers, and what is found."""

from dataclasses import dataclass

from orbitfb.core.signals import Mask, Vector


@dataclass(frozen=True, slots=True)
class Seen:
    """An orbit, and of what.

    Args:
        position: Shape (n,) [m].
        valid: BPMs that count, shape (n,).
        response: R of the policy in force, shape (n, m) [m/A].
        movable: Correctors that the loop moves, shape (m,).
        closed: Whether the loop is CLOSED.
        time: When it was complete, monotonic [s].
        held: Whether it is HELD: it asks for nothing, and what it had asked for is still owed.
    """

    position: Vector
    valid: Mask
    response: Vector
    movable: Mask
    closed: bool
    time: float
    held: bool = False


@dataclass(frozen=True, slots=True)
class Found:
    """What does not answer.

    Args:
        ring: Why the ring as a whole is not believed; empty when it is.
        bpms: BPMs that do not answer, by index.
        correctors: Correctors that the orbit does not answer, by index.
    """

    ring: str = ""
    bpms: tuple[int, ...] = ()
    correctors: tuple[int, ...] = ()


NOTHING = Found()

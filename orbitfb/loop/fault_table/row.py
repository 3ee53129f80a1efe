"""A row of the table of faults."""

from dataclasses import dataclass

from orbitfb.core.signals import LoopState


@dataclass(frozen=True, slots=True)
class Fault:
    """A row of the table.

    Args:
        event: What happens to a loop that is CLOSED.
        answer: What the loop does.
        states: States in which it may find itself, in their order.
        settings: Keys of the configuration that set it.
        tests: Tests that bring it about, by name.
    """

    event: str
    answer: str
    states: tuple[LoopState, ...]
    settings: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()

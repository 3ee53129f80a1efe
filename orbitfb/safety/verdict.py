"""What a check says: fine, say so, do not act on this orbit, hold the loop, trip it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from orbitfb.core.signals import Mask


class Action(IntEnum):
    """What a verdict asks of the loop; the larger one wins."""

    OK = 0
    """Nothing to say."""
    WARN = 1
    """Go on, but say so."""
    SKIP = 2
    """Do not act on this orbit; it counts as if none had come."""
    HOLD = 3
    """Write nothing until the cause is gone."""
    TRIP = 4
    """Open the loop and latch it until an operator resets it."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """The result of one check.

    Args:
        action: What it asks for.
        cause: The check that asks, one word of the glossary; empty when OK.
        reason: One sentence with figures; empty when OK.
    """

    action: Action
    cause: str = ""
    reason: str = ""

    @property
    def may_act(self) -> bool:
        """Whether the loop may decide and write on this orbit."""
        return self.action <= Action.WARN


FINE = Verdict(Action.OK)


def worst(*verdicts: Verdict) -> Verdict:
    """Pick the gravest verdict, the first one among equals."""
    return max(verdicts, key=lambda verdict: verdict.action, default=FINE)


def name_some(
    mask: Mask, names: Sequence[str], at_most: int = 5, told: Mapping[int, str] | None = None
) -> str:
    """List the first names under a mask, and how many more there are.

    Args:
        mask: Shape (m,).
        names: m names; when empty, the indices stand in for them.
        at_most: How many are spelt out.
        told: What there is to say of some, by index.
    """
    where, told = [int(index) for index in np.flatnonzero(mask)], told or {}
    shown = [
        (names[index] if names else f"#{index}") + (f" ({told[index]})" if index in told else "")
        for index in where[:at_most]
    ]
    more = len(where) - len(shown)
    return ", ".join(shown) + (f" and {more} more" if more else "")

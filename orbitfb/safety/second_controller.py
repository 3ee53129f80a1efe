"""A second controller on the same ring: somebody else moves our correctors, tick after tick.

An operator's hand moves some of them for some moments. Two loops on one ring fight each other, and
where no lease keeps them apart this is the only sign. A loop that is not closed does not close
beside another one. Of two that closed at the same moment one must give way: each draws lots, so
that they hardly ever do both.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some

UP, DOWN = 2, 1
"""Steps of the count at an orbit with and without moves of others: half of the orbits suffice, as a
loop that holds a tick back now and then writes at the others."""


@dataclass(frozen=True, slots=True)
class SecondController:
    """What is remembered of somebody else's moves.

    Args:
        count: `UP` for each orbit at which there were some, less `DOWN` for each without.
    """

    count: int = 0

    def look(
        self,
        by_others: Mask | None,
        mine: Mask,
        settings: InterlockSettings,
        names: Sequence[str] = (),
        closed: bool = False,
        draw: Callable[[], float] = lambda: 0.0,
    ) -> tuple[Verdict, "SecondController"]:
        """Look at what others have put since the last orbit.

        Args:
            by_others: Correctors that somebody else has put, shape (m,); None: none.
            mine: Correctors that the loop moves, or would, shape (m,).
            settings: Thresholds.
            names: The correctors, for the reason.
            closed: Whether the loop writes; else it waits to, or is asked to.
            draw: Gives a number from 0 to 1 at random.

        Returns:
            What to do, and what to remember.
        """
        most = UP * settings.second_controller_ticks
        moved = are_moved(by_others, mine, settings)
        count = min(self.count + UP, most) if moved else max(self.count - DOWN, 0)
        after = SecondController(count)
        if not count:
            return FINE, after
        sure = moved and count == most
        if closed and not sure:
            return FINE, after
        if not moved or by_others is None:
            told = "somebody else has just moved the setpoints: is there a second controller?"
            return Verdict(Action.HOLD, "second controller", told), after
        which = by_others & mine
        told = (
            f"somebody else moves {np.count_nonzero(which)} of {np.count_nonzero(mine)} setpoints "
            f"tick by tick, as a second controller does: {name_some(which, names, at_most=3)}; "
            "two loops on one ring fight each other: end the other one"
        )
        if not sure:
            return Verdict(Action.HOLD, "second controller", told), after
        gives_way = not closed or draw() * most < 1.0
        return Verdict(Action.TRIP if gives_way else Action.WARN, "second controller", told), after


def are_moved(by_others: Mask | None, mine: Mask, settings: InterlockSettings) -> bool:
    """Whether somebody else moves so many of our correctors that it is no single one of them.

    Args:
        by_others: Correctors that somebody else has put, shape (m,); None: none.
        mine: Correctors that the loop moves, shape (m,).
        settings: Thresholds; less than half of a few correctors is single ones, too.
    """
    if by_others is None or not settings.second_controller_ticks:
        return False
    few = min(settings.max_lost_correctors, int(np.count_nonzero(mine)) // 2)
    return int(np.count_nonzero(by_others & mine)) > few

"""The time that a search may take, and what it leaves undone when that is over.

A record is answered late but surely: what was best when the time was over is given, with the names
of what was not tried. Processor time counts, so that the answer does not depend on what else the
machine does.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from orbitfb.diagnose.candidate import Candidate

SEARCH_SECONDS = 180.0
"""Processor time that a search may take unless told otherwise [s]."""
SCAN_SHARE = 0.5
"""Share of it after which no more effects are scanned, so that some is left to fit what was."""


@dataclass(slots=True, eq=False)
class Budget:
    """Processor time of one search, counted from now.

    Args:
        seconds: That it may take [s].
        clock: Of the processor time [s].

    Attributes:
        unseen: Ids of effects that were not even looked for.
        untried: Causes that looked promising and were not fitted, of the tournament under way.
        undone: What else was left out, in words.
    """

    seconds: float = SEARCH_SECONDS
    clock: Callable[[], float] = time.process_time
    unseen: list[str] = field(default_factory=list)
    untried: list[Candidate] = field(default_factory=list)
    undone: list[str] = field(default_factory=list)
    _began: float = field(init=False)

    def __post_init__(self) -> None:
        self._began = self.clock()

    def over(self, share: float = 1.0) -> bool:
        """Whether a share of the time has passed."""
        return self.clock() - self._began > share * self.seconds

    def leave(self, what: str) -> None:
        """Keep in mind what was left out."""
        if what not in self.undone:
            self.undone.append(what)

    def taken(self) -> tuple[Candidate, ...]:
        """Hand over the causes that the tournament did not fit."""
        found = tuple(self.untried)
        self.untried.clear()
        return found

    def told(self, kinds: Sequence[str]) -> str:
        """Say what was left out; empty when nothing was.

        Args:
            kinds: Ids of effects of which a cause was not fitted.
        """
        parts = [f"effects not looked for: {', '.join(self.unseen)}"] if self.unseen else []
        parts += [f"promising causes not fitted: {', '.join(kinds)}"] if kinds else []
        parts += self.undone
        if not parts:
            return ""
        return (
            f"The search was cut short after {self.seconds:.0f} s of processor time; "
            f"{'; '.join(parts)}. Give it more time (--search-seconds) or a shorter record."
        )

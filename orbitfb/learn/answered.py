"""The history as the learner's rows are taken from it: only ticks that the ring answered."""

from collections.abc import Callable
from dataclasses import replace

from orbitfb.core.transitions import Transitions
from orbitfb.learn.succession import TransitionSource
from orbitfb.safety.believed import Believed


class AnsweredRows:
    """Transitions that wait for a sign of an answer are held back, refused ones are not usable.

    Args:
        history: The last transitions.
        believed: Tells which ticks were answered.
    """

    def __init__(self, history: TransitionSource, believed: Callable[[], Believed]) -> None:
        self._history, self._believed = history, believed

    def snapshot(self, last: int | None = None, since_tick: int | None = None) -> Transitions:
        """Copy the transitions that are judged.

        Args:
            last: At most that many, the latest ones.
            since_tick: Only those that begin at this tick or later.
        """
        believed = self._believed()
        transitions = self._history.snapshot(since_tick=since_tick)
        end = int((transitions.tick < believed.until).sum())
        begin = 0 if last is None else max(0, end - last)
        judged = transitions.part(begin, end)
        return replace(judged, usable=judged.usable & believed.teaches(judged.tick))

"""Moves on their way to the loop, the one under way, and those that can be undone."""

import threading
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import Mask, Reading, Vector
from orbitfb.loop.correction.move import Move, Way, next_step
from orbitfb.loop.lending.turn import Turn
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.limits import Limited


@dataclass(frozen=True, slots=True)
class Done:
    """A move that was made, whole or in part.

    Args:
        name: What it was.
        start: Setpoints before it, shape (m,) [A].
        left: Setpoints that it left, shape (m,) [A].
        before: Rms orbit error before it [m].
        after: That of the last orbit of it [m].
        steps: Steps that were sent.
    """

    name: str
    start: Vector
    left: Vector
    before: float
    after: float
    steps: int


@dataclass(frozen=True, slots=True)
class _Order:
    move: Move
    outcome: Future[Done]
    undoes: Done | None


class Hand:
    """Takes orders in any thread and carries them out, one at a time, in the loop's.

    Args:
        depth: Moves that can be undone.
        turn: Whose turn it is to move setpoints.

    Attributes:
        made: Moves that can be undone, oldest first; any thread may read it.
    """

    def __init__(self, depth: int, turn: Turn) -> None:
        self._depth, self._turn = depth, turn
        self._lock = threading.Lock()
        self._order: _Order | None = None
        self._way: Way | None = None
        self.made: tuple[Done, ...] = ()

    @property
    def busy(self) -> bool:
        """Whether a move is ordered or under way."""
        return self._order is not None

    def order(self, move: Move, undoes: Done | None = None) -> Future[Done]:
        """Ask for a move; it begins at the next orbit.

        Args:
            move: What is wanted.
            undoes: What it takes back; None: it is a new one.

        Returns:
            Its outcome, or a `ControlError` that says why it ended early.

        Raises:
            ControlError: Another one is under way, or the loop has ended.
        """
        order = _Order(move, Future(), undoes)
        self._turn.take(move.name)
        if undoes is not None and (not self.made or self.made[-1] is not undoes):
            self._turn.leave()
            raise ControlError(f"{move.name} refused: it is not the last one any more")
        self._order = order
        return order.outcome

    def step(
        self,
        memory: LoopMemory,
        checked: Checked,
        reading: Reading,
        rules: Rules,
        mine: Mask,
        bounds: Bounds,
    ) -> Limited | None:
        """Say what to send at this orbit; None: nothing.

        Args:
            memory: Of the loop, with the setpoints that the machine has just stated.
            checked: The orbit of this tick, looked at as if the loop were to close.
            reading: The same as it came.
            rules: Limits of the steps.
            mine: Correctors that the loop would move, shape (m,).
            bounds: Where the setpoint of each may be.
        """
        order, way = self._order, self._way
        if order is None:
            return None
        if way is None:
            if not order.outcome.set_running_or_notify_cancel():
                self._order = None
                self._turn.leave()
                return None
            way = Way(order.move, order.move.start, reading.received)
        after = next_step(way, memory, checked, rules, mine, bounds, reading.received)
        self._way = after.way
        if after.ends:
            self._end(order, after.way, after.reason)
        return after.limited

    def fail(self, reason: str) -> None:
        """End the move under way, if there is one: its last step was not sent, or not all.

        Args:
            reason: Why.
        """
        order, way = self._order, self._way
        if order is not None and way is not None:
            self._end(order, way, reason)

    def end(self, reason: str) -> None:
        """Refuse what is under way: the loop has ended."""
        order = self._order
        if order is not None and (self._way or order.outcome.set_running_or_notify_cancel()):
            self._end(order, self._way or Way(order.move, order.move.start, 0.0), reason)

    def _end(self, order: _Order, way: Way, reason: str) -> None:
        move, undone = order.move, order.undoes
        start = np.where(move.aim == move.start, way.at, move.start)
        done = Done(move.name, start, way.at, way.before, way.rms, way.steps)
        with self._lock:
            if way.steps:
                if undone is None:
                    self.made = (*self.made, done)[-self._depth :]
                elif reason:  # part of it is left to undo
                    part = Done(undone.name, undone.start, way.at, way.rms, way.rms, way.steps)
                    self.made = (*self.made[:-1], part)
                else:
                    self.made = self.made[:-1]
            self._order = self._way = None
        self._turn.leave()
        if not reason:
            order.outcome.set_result(done)
            return
        verb = f"stopped after {way.steps} steps" if way.steps else "refused"
        order.outcome.set_exception(ControlError(f"{move.name} {verb}: {reason}"))

"""Beside a fast feedback that is closed: it corrects, and we hand over the reference.

A step moves its reference towards ours by as much as our own reference may move in the time. The
next step begins with reading back the one before: what is not there was not taken, or somebody else
sets it, and then it is his.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from orbitfb.core.errors import ControlError, MachineError
from orbitfb.core.signals import Mask, Vector
from orbitfb.loop.adjustments import approach

OFF, HANDS_OVER, STOPPED = "OFF", "HANDS OVER", "STOPPED"
"""States: nobody wants it, or the fast feedback is open; our reference is handed over; it was let
go, the reason says why."""


class FastReference(Protocol):
    """The reference orbit of a fast feedback."""

    @property
    def which(self) -> Mask:
        """BPMs whose reference it has, shape (n,)."""
        ...

    def ask(self) -> Vector:
        """Ask for the reference in force, shape (k,) [m], of the BPMs of `which`.

        Raises:
            MachineError: A value is not known.
        """
        ...

    def put(self, values: Vector) -> None:
        """Send a reference, shape (k,) [m].

        Raises:
            WriteError: It cannot be sent; nothing was.
        """
        ...


@dataclass(frozen=True, slots=True)
class Handing:
    """How the hand-over is.

    Args:
        state: `OFF`, `HANDS_OVER` or `STOPPED`.
        reason: Why it is not handed over, or waits; empty: nothing to say.
        left: Largest difference of the two references at a BPM [m]; NaN: not known.
    """

    state: str = OFF
    reason: str = ""
    left: float = float("nan")


class HandOver:
    """Hands our reference to a fast feedback, step by step.

    Args:
        reference: Of the fast feedback.
        wanted: Gives our reference orbit, shape (n,) [m].
        status: Says why the fast feedback is not known to be closed; empty when it is.
        refusal: Says why the machine must not be written to now; empty when it may.
        step: Largest movement at a BPM [m].
        tolerance: Largest difference between what was put and what is read back [m].

    Attributes:
        sight: How it is; any thread may read it.
    """

    def __init__(
        self,
        reference: FastReference,
        wanted: Callable[[], Vector],
        status: Callable[[], str],
        refusal: Callable[[], str],
        step: float,
        tolerance: float,
    ) -> None:
        self._reference, self._wanted = reference, wanted
        self._status, self._refusal = status, refusal
        self._step, self._tolerance = step, tolerance
        self._asked: Vector | None = None
        self.sight = Handing()

    @property
    def applies(self) -> bool:
        """Whether the fast feedback is closed, so that it corrects and not we."""
        return not self._status()

    def begin(self) -> None:
        """Hand over from now on, from where the reference of the fast feedback is.

        Raises:
            ControlError: The fast feedback is not known to be closed, the machine must not be
                written to, or its reference cannot be read.
        """
        told = self._status() or self._refusal()
        if not told:
            try:
                self._asked = self._reference.ask()
            except MachineError as error:
                told = str(error)
        if told:
            raise ControlError(f"the reference is not handed over: {told}")
        self.sight = Handing(HANDS_OVER, "", self._left(self._wanted()[self._reference.which]))

    def end(self) -> None:
        """Leave the reference of the fast feedback where it is."""
        self.sight, self._asked = Handing(), None

    def step(self) -> None:
        """Read back the last step, and make the next one."""
        asked = self._asked
        if self.sight.state != HANDS_OVER or asked is None:
            return
        if told := self._status():
            self.sight, self._asked = Handing(OFF, told), None
            return
        if told := self._refusal():
            self._wait(told)
            return
        try:
            there = self._reference.ask()
            away = float(np.abs(there - asked).max(initial=0.0))
            if away > self._tolerance:
                self._stop(away, there, asked)
                return
            aim = self._wanted()[self._reference.which]
            following = approach(there, aim, self._step)
            if float(np.abs(following - there).max(initial=0.0)) > self._tolerance:
                self._reference.put(following)
                self._asked = following
        except MachineError as error:
            self._wait(str(error))
            return
        self.sight = Handing(HANDS_OVER, "", self._left(aim))

    def _left(self, aim: Vector) -> float:
        if self._asked is None:
            return float("nan")
        return float(np.abs(aim - self._asked).max(initial=0.0))

    def _wait(self, told: str) -> None:
        self.sight = Handing(HANDS_OVER, told, self.sight.left)

    def _stop(self, away: float, there: Vector, asked: Vector) -> None:
        at = int(np.abs(there - asked).argmax())
        bpm = int(np.flatnonzero(self._reference.which)[at])
        self.sight = Handing(
            STOPPED,
            f"the reference of the fast feedback is not what was put: {there[at] * 1e6:.3f} µm at "
            f"BPM {bpm} of the table, not {asked[at] * 1e6:.3f} µm ({away * 1e6:.3g} µm away); "
            "somebody else sets it, or it does not take puts. `orbitfb command close` hands over "
            "from where it is now",
        )
        self._asked = None

"""What the loop has asked for, who owes an answer to it, and what that forbids."""

import math
from dataclasses import dataclass

import numpy as np

from orbitfb.core.robust import median
from orbitfb.core.signals import Mask, Vector
from orbitfb.core.values import replace
from orbitfb.safety.answers.evidence import Test
from orbitfb.safety.answers.expectation import NEAR, Expectation, Owed
from orbitfb.safety.answers.questions import Question, Ring
from orbitfb.safety.interlocks import InterlockSettings

LAGS = 3
"""Orbits at which an answer may come: in time, or one or two late."""

LOUD = 40.0
"""What is at stake over a question [1]: an answer costs a part of 40 of what it is about."""

LOUDEST = 0.1
"""Largest question over the orbit error [1], where that is large: it adds half a percent to it."""

STAKE = 1.5
"""Times `answer_reach` that a BPM or a corrector, or the correctors together, may owe before it has
no say [1]: half as much again for the time that asking takes."""

MOST = 2.0
"""Times `answer_reach` that one may owe before the loop waits for it alone [1]: what the BPMs
beside one that has no say ask for moves the orbit there too, so that it goes on owing more."""

SETTLED = 20
"""Orbits after which it is known what is usual."""

FEW = 0.05
"""Share of the devices that may have no say at once [1]: a cell of both kinds. If more owe as much
the loop waits for their answers instead, as the rest could not hold the orbit."""

GRACE = 30
"""Orbits of asking before the loop waits for the answers of devices: a kick is corrected
meanwhile. For the first answer of the ring it waits at once: that comes in a few orbits."""

HALF = 0.5
"""Share of `answer_reach` below which nobody is in doubt any more [1], once somebody was."""


def rms(orbit: Vector) -> float:
    """Size of an orbit, rms over the BPMs [m]."""
    return math.sqrt(float(np.add.reduce(orbit**2)) / len(orbit))


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """What was sent after an orbit.

    Args:
        change: Of the setpoints, shape (m,) [A].
        moved: R times it, shape (n,) [m].
        question: The part of it that was drawn; None: none was.
    """

    change: Vector
    moved: Vector
    question: Question | None = None

    def standing(self) -> "Sent":
        """Give what is sent if nothing is: no change, and the question stands."""
        return Sent(np.zeros_like(self.change), np.zeros_like(self.moved), self.question)


@dataclass(frozen=True, eq=False)
class Session:
    """Asking.

    Args:
        whole: Of the ring.
        devices: Of the BPMs and correctors.
        answered: Whether the ring has.
        waited: Orbits in a row at which the loop only asked.
        orbits: Orbits since it began.
        doubted: Whether a device was in doubt at its beginning; else the ring is asked alone.
        stopped: Whether one has owed so much that nothing is corrected until all have answered.
    """

    whole: Test
    devices: Test
    answered: bool = False
    waited: int = 0
    orbits: int = 0
    doubted: bool = True
    stopped: bool = False

    @classmethod
    def begin(cls, n: int, m: int, doubted: bool = True) -> "Session":
        """Begin to ask n BPMs and m correctors."""
        return cls(Test.none(LAGS + 2, 1), Test.none(2, n + m), doubted=doubted)

    @property
    def silence(self) -> float:
        """Evidence z that the ring answers at no lag, nor at now this one, now that [1]."""
        each = self.whole.first(LAGS).silence[0]
        any_lag = self.whole.last(1).silence[0]
        return float(min(each, any_lag))

    def anew(self, n: int, m: int) -> "Session":
        """Hear everybody anew, as others are asked; how long the loop has asked still counts."""
        fresh = Session.begin(n, m)
        return replace(self, whole=fresh.whole, devices=fresh.devices)

    def without(self, silent: Mask, n: int) -> "Session":
        """Go on without some of n BPMs and some correctors, shape (n + m,), that do not answer.

        What a BPM has said of itself still holds. What was said of the ring and the correctors
        does not: it rests on all BPMs that count.
        """
        forgotten = silent.copy()
        forgotten[n:] = True
        return replace(self, whole=Test.none(LAGS + 2, 1), devices=self.devices.anew(forgotten))


@dataclass(frozen=True, eq=False)
class Answering:
    """What is remembered from tick to tick.

    Args:
        ring: Of the policy in force; None: not known.
        expected: Of the next orbit; None before the first.
        sent: After the last orbits, newest first.
        owed: What was asked for without a sign of an answer; None: the loop is not closed.
        session: Asking; None: nobody is in doubt.
        lag: Orbits by which the ring answers late.
        since: When it answered last, or the loop closed, monotonic [s].
        left: BPMs that are left out as they do not answer, shape (n,); None: none.
        found: How often something was found not to answer.
        gap: Orbits that were missed before the next one.
        start: The orbit on which the loop closed, shape (n,) [m]; None: not known.
        heard: Questions that may still be answered, and the sum of what was read since less what
            was read before, each of shape (n,) [m].
    """

    ring: Ring | None = None
    expected: Expectation | None = None
    sent: tuple[Sent, ...] = ()
    owed: Owed | None = None
    session: Session | None = None
    lag: int = 0
    since: float = float("nan")
    left: Mask | None = None
    found: int = 0
    gap: int = 0
    start: Vector | None = None
    heard: tuple[tuple[Question, Vector], ...] = ()

    def hear(self, position: Vector) -> tuple["Answering", list[tuple[Question, Vector]]]:
        """Add an orbit, shape (n,) [m], to what the last questions heard.

        Returns:
            The memory, and those whose time is over.
        """
        asked = [item.question for item in self.sent[:LAGS] if item.question is not None]
        known = {id(question): (question, total) for question, total in self.heard}
        nothing = np.zeros_like(position)
        now = {id(item): known.pop(id(item), (item, nothing)) for item in asked}
        heard = tuple((item, total + position - item.still) for item, total in now.values())
        return replace(self, heard=heard), list(known.values())

    def question(self, settings: InterlockSettings, error: float = 0.0) -> float:
        """Say how large a question is wanted: orbit, rms over the BPMs [m]; 0: none is.

        Args:
            settings: How large it may be on a good orbit, and what may be owed.
            error: Usual size of the orbit error [m].
        """
        ring, owed, expected = self.ring, self.owed, self.expected
        reach = settings.answer_reach
        if self.session is None or ring is None or owed is None or expected is None:
            return 0.0
        if reach is None or settings.answer_question == 0:
            return 0.0
        loud = min(LOUDEST * error, HALF * reach)
        most = max(settings.answer_question, loud)
        if self.waits(settings):
            return most
        # A corrector is told by the count of questions, not by how loud they are.
        stake = max(float(np.abs(owed.bpms).max(initial=0.0)), rms(owed.ring))
        noise = median(expected.spread)
        return min(max(stake / LOUD, noise, loud), most)

    def doubted(self, settings: InterlockSettings) -> Mask | None:
        """Find the BPMs and correctors that have no say, shape (n + m,); None: all have."""
        doubted = self._owing(settings)
        return doubted if doubted is not None and doubted.mean() <= FEW else None

    def _owing(self, settings: InterlockSettings) -> Mask | None:
        """Find who owes so much that it must have answered by now; None: nobody."""
        reach, session = settings.answer_reach, self.session
        if reach is None or self.owed is None or session is None or self.ring is None:
            return None
        if session.orbits < GRACE:
            return None
        owing = self.owed.sizes(self.ring) > STAKE * reach
        return owing if owing.any() else None

    def overdue(self, owed: Owed) -> float:
        """Give the most that a BPM owes whose answer is due [m].

        Args:
            owed: By all.
        """
        return float(self._due(owed).max(initial=0.0))

    def _due(self, owed: Owed) -> Vector:
        """Give what each BPM owes whose answer is due, shape (n,) [m]."""
        due = owed.bpms - sum(item.moved for item in self.sent[: self.lag])
        return np.minimum(np.abs(owed.bpms), np.abs(due))  # what is not due may be paid

    def _stands_still(self, owed: Owed, reach: float) -> bool:
        """Say whether a BPM has hardly moved since the loop closed, of much that it was asked to.

        Before it is known what is usual nobody is asked. A BPM that does not see the beam has the
        loop move it there meanwhile, by one correction after the other.
        """
        expected, start = self.expected, self.start
        if expected is None or start is None or expected.orbits >= SETTLED:
            return False
        due, went = self._due(owed), np.abs(expected.before - start)
        return bool(((due > MOST * reach) & (went < NEAR * due)).any())

    def waits(self, settings: InterlockSettings) -> bool:
        """Say whether the loop only asks: the ring owes too much."""
        reach = settings.answer_reach
        if reach is None or self.owed is None:
            return False
        if self.session is None:
            return self._stands_still(self.owed, reach)
        arrived = self.owed.ring.copy()
        for item in self.sent[: self.lag]:
            arrived -= item.moved
        owes = rms(arrived) > reach
        if owes and not self.session.answered:
            return True
        if self.ring is None:
            return False
        if self.session.stopped or self.overdue(self.owed) > MOST * reach:
            return True
        if self.session.orbits < GRACE:
            return False
        others, owing = self.owed.correctors, self._owing(settings)
        if owing is not None:
            if owing.mean() > FEW:
                return True
            others = np.where(owing[-len(others) :], 0.0, others)  # those in doubt rest
        return owes or rms(self.ring.response @ others) > STAKE * reach

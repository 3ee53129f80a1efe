"""The loop asks whether the orbit answers (`safety.answers`), and heeds what it is told."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.robust import median
from orbitfb.core.signals import LoopState, Mask, Reading, Vector
from orbitfb.core.values import replace
from orbitfb.loop.guard import Guard
from orbitfb.loop.memory import LoopMemory, Rules
from orbitfb.loop.tick import Checked
from orbitfb.loop.timing.waiting import too_early
from orbitfb.safety.answers.answering import interrupted, look, note
from orbitfb.safety.answers.findings import Found, Seen
from orbitfb.safety.answers.owing import Sent
from orbitfb.safety.answers.questions import Question, Rings
from orbitfb.safety.verdict import FINE, Action, Verdict, name_some

WAITS = "no corrections until the orbit has answered a test excitation"
"""Said while too much was asked for without a sign of an answer."""

UNANSWERED = "the orbit does not answer it"
"""Why a corrector is left out."""


@dataclass(frozen=True, slots=True)
class Heeded:
    """What the loop acts on.

    Args:
        checked: The orbit, without what BPMs in doubt say.
        resting: Correctors that stay where they are, shape (m,).
        reason: Who has no say; empty when all have.
    """

    checked: Checked
    resting: Mask
    reason: str


class Inquiry:
    """Draws the questions, and tells the loop who does not answer.

    Args:
        rules: Settings and names.
        guard: Has the response of the policy in force.
        random: Draws them; None: one that nobody can foretell, as at a machine.
    """

    def __init__(
        self, rules: Rules, guard: Guard, random: np.random.Generator | None = None
    ) -> None:
        self._settings, self._names, self._guard = rules.interlocks, rules.channels, guard
        self._random = random or np.random.default_rng()
        self._asked: Question | None = None
        self._early = False
        self._rings, self._mine = Rings(), np.zeros(0, dtype=np.bool_)

    def prepare(self, policy: Policy) -> None:
        """Look at the response of a policy before it is in force: that takes longer than a tick.

        Args:
            policy: It is about to be swapped in, by whichever thread this is.
        """
        response: Vector | None = getattr(policy, "response", None)
        mine = self._mine
        if response is not None and response.shape[1] == len(mine):
            self._rings.of(response, mine)

    def look(self, memory: LoopMemory, reading: Reading, mine: Mask) -> tuple[Verdict, LoopMemory]:
        """Compare an orbit with what was asked of it.

        Args:
            memory: So far.
            reading: The orbit, screened.
            mine: Correctors that the loop moves, shape (m,).

        Returns:
            A trip if the ring does not answer, and the memory: BPMs that do not are left out of the
            next orbit, correctors from this one on. An orbit that is older than the last change is
            not looked at.
        """
        response, self._early = self._guard.response, False
        if response is None:
            return FINE, memory
        orbit, closed = reading.orbit, memory.state is LoopState.CLOSED
        held = memory.state is LoopState.HELD
        self._early = closed and too_early(memory, reading, mine)
        if self._early:
            return FINE, memory
        self._mine = mine
        seen = Seen(orbit.position, orbit.valid, response, mine, closed, reading.received, held)
        found, answering = look(seen, memory.answering, self._settings, self._rings)
        memory = replace(memory, answering=answering)
        return self._heed(found, memory)

    def _heed(self, found: Found, memory: LoopMemory) -> tuple[Verdict, LoopMemory]:
        if found.ring:
            return Verdict(Action.TRIP, "answer", found.ring), memory
        if not found.correctors:
            return FINE, memory
        if not self._guard.can_leave_out:
            silent = np.zeros(len(memory.lost), dtype=np.bool_)
            silent[list(found.correctors)] = True
            names = name_some(silent, self._names.correctors)
            reason = f"the orbit does not answer {names}, whatever the readback says"
            return Verdict(Action.TRIP, "answer", reason), memory
        told = {**memory.refusals.found, **dict.fromkeys(found.correctors, UNANSWERED)}
        return FINE, replace(memory, refusals=replace(memory.refusals, found=told))

    def missed(self, memory: LoopMemory, orbits: int) -> LoopMemory:
        """Live through orbits that were missed; their count."""
        return replace(memory, answering=interrupted(memory.answering, orbits))

    def waits(self, memory: LoopMemory) -> bool:
        """Say whether nothing is to be corrected, as too much is owed."""
        return memory.answering.waits(self._settings)

    def heeded(self, memory: LoopMemory, checked: Checked) -> Heeded:
        """Let devices in doubt have no say: BPMs do not count, correctors rest.

        Args:
            memory: Of the loop.
            checked: The orbit.
        """
        doubted, n = memory.answering.doubted(self._settings), len(checked.error)
        if doubted is None:
            return Heeded(checked, np.zeros_like(memory.lost), "")
        names = (*self._names.bpms, *self._names.correctors)
        reason = f"{name_some(doubted, names)}: not used until the orbit has answered"
        error, valid = np.where(doubted[:n], 0.0, checked.error), checked.valid & ~doubted[:n]
        return Heeded(replace(checked, error=error, valid=valid), doubted[n:], reason)

    def question(self, memory: LoopMemory, checked: Checked) -> Vector | None:
        """Draw a question if one is wanted: an excursion, shape (m,) [A].

        Args:
            memory: Of the loop.
            checked: The orbit.
        """
        answering, self._asked = memory.answering, None
        if answering.session is None:
            return None
        seen = np.abs(checked.error[checked.valid])
        size = answering.question(self._settings, median(seen) if seen.size else 0.0)
        if size == 0 or answering.ring is None or answering.expected is None:
            return None
        ring = answering.ring
        drawn = self._random.integers(0, 2, len(ring.patterns.T))
        signs = np.asarray(2.0 * drawn - 1.0, dtype=np.float64)
        excursion: Vector = ring.patterns @ (size * signs)
        still = answering.expected.still
        self._asked = Question(size, excursion, ring.response @ excursion, still)
        return excursion

    def sent(
        self,
        memory: LoopMemory,
        change: Vector,
        moved: Vector,
        question: Vector | None,
        mine: Mask,
    ) -> LoopMemory:
        """Remember what was sent.

        Args:
            memory: So far.
            change: Of the setpoints, shape (m,) [A].
            moved: What that does to the orbit, shape (n,) [m].
            question: The part of it that was drawn, if it was sent as it was; None: none was.
            mine: Correctors that the loop moves, shape (m,).
        """
        if self._early and not change.any():  # what was sent before has not been looked for yet
            return memory
        if self._early:
            memory = self.missed(memory, 1)
        asked, ring = self._asked, memory.answering.ring
        if question is None or ring is None or not np.array_equal(ring.movable, mine):
            asked = None
        return replace(memory, answering=note(memory.answering, Sent(change, moved, asked)))

"""The tournament: all hypotheses, the best accepted, and again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.likelihood.corrected import over, redrawn
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.beside import enough_beside, is_another
from orbitfb.diagnose.selection.echoes import (
    coloured_names,
    is_echo,
    is_of_ground,
    last_resort,
    oddness,
)
from orbitfb.diagnose.selection.healthy_motion import with_motion
from orbitfb.diagnose.selection.own_floors import refitted, with_noise_after
from orbitfb.diagnose.selection.proper import proper
from orbitfb.diagnose.selection.settled import settled
from orbitfb.diagnose.selection.undecided import drawn_with, leaders, undecided
from orbitfb.diagnose.selection.unknown import unknown_laws
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.priors import (
    AT_ONCE,
    FINALISTS,
    HEARD,
    REMAINDER,
    ROUNDS,
    SURE,
)

_Told = TypeVar("_Told", Candidate, FreeCourse)


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round: every candidate, the best first, and the workspace that they were tried on.

    Args:
        space: Before anything of the round was accepted.
        candidates: Every one that was tried.
        free: Unknown laws of single devices, of cells and of all alike, the most telling first.
    """

    space: Workspace
    candidates: tuple[Candidate, ...]
    free: tuple[FreeCourse, ...]

    @property
    def unknown(self) -> tuple[FreeCourse, ...]:
        """Unknown laws that are sure, the most telling first."""
        return tuple(one for one in self.free if one.evidence > SURE)

    def nameless(self, first: float, together: float) -> FreeCourse | None:
        """An unknown law that is surely likelier than what is named; None: there is none.

        What all devices do alike may be several causes of the library, a device or cell does one.
        Laws of the library are a little wrong, and an unknown law has what they leave, too: it
        needs more than that.

        Args:
            first: Evidence of the first cause [nats].
            together: Of all [nats].
        """
        for one in self.free:
            known = together if one.of_all else first
            if one.evidence > known + enough_beside(known, self.space):
                return one
        return None

    def left(self, told: float) -> Candidate | None:
        """The best that is sure beside causes with that evidence [nats]; None: there is none."""
        enough = enough_beside(told, self.space)
        return next((one for one in self.candidates[:1] if one.evidence > enough), None)


def _told_again(causes: Sequence[Candidate], space: Workspace) -> tuple[list[Candidate], Workspace]:
    """Accept causes anew on a workspace without them, whose floor they had no part in.

    Args:
        causes: In the order in which they were accepted.
        space: With the floor.
    """
    told = []
    for one in causes:
        best, space = settled(one, space)
        told.append(best)
    return told, space


def tournament(
    space: Workspace,
    kinds: Sequence[EffectKind],
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[list[Candidate], list[Round]]:
    """Accept the best hypothesis while one is sure.

    Args:
        space: Of the record.
        kinds: Effects that the record can show.
        tell: Is told the effect that is tried, and what it takes.

    Returns:
        The accepted candidates in order, and all rounds; of the last one nothing was accepted,
        although it may have a candidate that is sure.
    """
    accepted: list[Candidate] = []
    rounds: list[Round] = []
    causes = 0  # what a law finds once more is none of its own
    odd = 0.0  # a BPM is, before any law is accepted [nats]
    led: Candidate | None = None  # what may be the next cause, in readings that were drawn with it
    space = first = redrawn(space)
    while True:
        told = {one.kind.id for one in accepted if one.noisy}
        left = [kind for kind in kinds if kind.id not in told]
        enough = enough_beside(sum(one.evidence for one in accepted), space)
        owed = space.unevenness()
        gross = enough + owed
        candidates = candidates_of(space, left, tell, gross)
        waits = led is None  # for readings that are drawn with it
        if led is not None:
            candidates, led = strongest([led, *candidates]), None
        candidates = [one for one in candidates if not is_echo(one, accepted)]
        if candidates and candidates[0].evidence > 0.5 * gross:
            space = space.saturable()  # every floor from here on begins with it
        drawn = bool(space.signals.record.filled.any())
        weighing = refitted(candidates, space, gross)
        candidates, lost = _less(weighing.candidates, owed), weighing.lost
        alone = all(map(is_of_ground, accepted))
        odd = oddness(candidates, drawn) if alone else odd
        of_bpms = any(one.kind.target == "bpm" for one in accepted)  # one of them says it all
        candidates = last_resort(candidates, None if alone else 0.0 if of_bpms else odd, drawn)
        candidates = proper(candidates, space.signals)
        deaf = coloured_names(accepted)
        base = None if accepted else weighing.base  # beside causes it is a share of them
        free = _less(unknown_laws(weighing.bare, candidates[:1], deaf, base), owed)
        if candidates:
            rival = max((one.evidence for one in free if one.target == "bpm"), default=0.0)
            heard = with_noise_after(candidates[0], weighing, rival, owed)
            candidates = [heard, *candidates[1:]]
        rounds.append(Round(space, tuple(_light(candidates)), tuple(free)))
        for one in candidates[:6]:
            tell("top " + one.describe())
        sure = (
            one
            for one in candidates[:1]
            if one.evidence >= enough or is_another(one, accepted, space)
        )
        best = next(sure, None)
        unnamed = max((one.evidence for one in free if not one.of_all), default=0.0)
        if best is None and unnamed <= SURE:
            return accepted, rounds
        # Beside causes, what all do alike may be a share of them: it is no rival of the motion.
        rivals = [one.evidence for one in free if not (accepted and one.of_all)]
        moving = with_motion(space, max([0.0 if best is None else best.evidence, *rivals]))
        if moving is not None:
            tell("top healthy motion")
            space = moving
            if accepted:  # they were told over a floor of another form
                accepted, space = _told_again(accepted, over(first, moving))
            rounds.pop()
            continue
        if best is None or causes == ROUNDS or _composed([*accepted, best]):
            return accepted, rounds
        # More effects than these are not at work at once: it need not be sought what they leave.
        named = sum(one.candidates[0].evidence for one in rounds)
        if causes >= AT_ONCE and rounds[0].nameless(np.inf, named) is not None:
            return accepted, rounds
        if not accepted and rounds[-1].nameless(best.evidence, np.inf) is not None:
            return accepted, rounds  # nothing of the library is as good
        unsure = undecided(leaders(candidates), space) if waits else []
        if unsure:
            best, space = drawn_with(unsure, space)
        if len(unsure) > 1:
            led = best
            rounds.pop()
            continue
        best, after = settled(best, space.trusting())
        space = redrawn(after)
        if lost and best.again is None:
            # what it may leave to others is a share of all that it explains
            best = replace(best, evidence=best.evidence + lost)
        accepted.append(best)
        causes += 1
        for _ in range(HEARD):
            more = _once_more(accepted, space)
            if more is None:
                break
            tell("top again " + more.describe())
            rounds.append(Round(space, (more,), ()))
            accepted.append(more)
            space = redrawn(more.accepted(space.trusting(), spread=False))


def _less(found: list[_Told], owed: float) -> list[_Told]:
    """The same with less evidence, if any is owed [nats]."""
    return [replace(one, evidence=one.evidence - owed) for one in found] if owed else found


def _once_more(accepted: Sequence[Candidate], space: Workspace) -> Candidate | None:
    """What a law that remembers finds again at the devices of the last cause; None: too little.

    No magnet follows such a law to the last part: it leaves some of what it explains, and others
    would find that, too. To tell states and values once more, device by device, takes as long as
    all the rest, so what is found stays as it was scanned.

    Args:
        accepted: Causes.
        space: With them.
    """
    last = accepted[-1]
    if not last.kind.remembers or not last.sources:
        return None
    # Half of what would be enough: as much again may be in the floor.
    least = 0.5 * enough_beside(sum(one.evidence for one in accepted), space)
    for one in candidates_of(space, [last.kind]):
        its = one.kind is last.kind and bool(one.sources) and set(one.places) == set(last.places)
        if its and least < one.evidence < REMAINDER * last.evidence:
            return one
    return None


def _composed(causes: Sequence[Candidate]) -> bool:
    """Whether more effects are at work, each with a share that counts, than a record has at once.

    A law that is in the library takes nearly all that it does. One that is not is taken to pieces:
    as much is left after every effect that is accepted as before. Devices of one effect are one,
    and so are errors of all devices, which a model that was never calibrated has of every kind.
    """
    whole = sum(one.evidence for one in causes)
    large = [one for one in causes if one.evidence > REMAINDER * whole]
    return len({"" if one.raised else one.kind.id for one in large}) > AT_ONCE


def _light(candidates: list[Candidate]) -> list[Candidate]:
    """Drop the fields of all but the finalists: each is as large as the record."""
    light = [replace(one, after=None) for one in candidates]
    rest = [replace(one, field=None, finer=None) for one in light[FINALISTS:]]
    return [*light[:FINALISTS], *rest]

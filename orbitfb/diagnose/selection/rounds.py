"""The tournament: all hypotheses, the best accepted, and again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.free_course import FreeCourse, scan_free
from orbitfb.diagnose.hypotheses.scan import candidates_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over, redrawn
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.beside import enough_beside, is_another
from orbitfb.diagnose.selection.healthy_motion import with_motion
from orbitfb.diagnose.selection.own_floors import refitted
from orbitfb.diagnose.selection.settled import settled
from orbitfb.diagnose.selection.undecided import drawn_with, leaders, undecided
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.priors import (
    AT_ONCE,
    FINALISTS,
    HEARD,
    REMAINDER,
    ROUNDS,
    SURE,
    SWALLOWED,
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
        candidates = [one for one in candidates if not _echo(one, accepted)]
        if candidates and candidates[0].evidence > 0.5 * gross:
            space = space.saturable()  # every floor from here on begins with it
        drawn = bool(space.signals.record.filled.any())
        candidates, bare, lost = refitted(candidates, space, gross)
        candidates = _less(candidates, owed)
        alone = all(map(_of_ground, accepted))
        odd = _oddness(candidates, drawn) if alone else odd
        of_bpms = any(one.kind.target == "bpm" for one in accepted)  # one of them says it all
        candidates = _last_resort(candidates, None if alone else 0.0 if of_bpms else odd, drawn)
        deaf = _coloured(accepted)
        free = [one for one in scan_free(Scorer.of(bare)) if deaf.isdisjoint(one.names)][:FINALISTS]
        free = _less(free, owed)
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
        moving = with_motion(space, max(0.0 if best is None else best.evidence, unnamed))
        if moving is not None:
            tell("top healthy motion")
            space = moving
            if accepted:  # they were told over a floor of another form
                accepted, space = _told_again(accepted, over(first, moving))
            rounds.pop()
            continue
        if best is None or causes == ROUNDS or _composed([*accepted, best]):
            return accepted, rounds
        if not accepted and unnamed > best.evidence:
            return accepted, rounds  # nothing of the library is as good as a law without a name
        rivals = undecided(leaders(candidates), space) if waits else []
        if rivals:
            best, space = drawn_with(rivals, space)
        if len(rivals) > 1:
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


def _echo(one: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Whether it says again what is said of its BPMs.

    A BPM that averages, scales or delays does so to its noise as well, and what its law leaves
    wanders with the orbit: its noise, or what it reads, is not odd besides. And of a BPM whose
    noise is told to remember no law of its readings is: a feedback that acts on them makes the beam
    follow that noise, which looks like a law, and no floor has such a noise. One law is enough for
    the noise of a BPM: no floor has it, so that others would be as true. Readings are undone as
    they were read, so once only. And what a wave leaves, as the optics are a little wrong, is that
    wave, wherever another effect finds it.
    """
    if _is_same_wave(one, accepted):
        return True
    if one.kind.target != "bpm":
        return False
    if one.undone is not None and any(
        its.kind.target == "bpm" and set(its.places) & set(one.places) for its in accepted
    ):
        return True
    if one.places and set(one.names) <= _coloured(accepted):
        return True
    if not (one.noisy or one.courseless):
        return False
    known = [
        set(its.places)
        for its in accepted
        if its.kind.target == "bpm" and (one.noisy or not its.noisy)
    ]
    return any(not places or (one.places and set(one.places) <= places) for places in known)


def _is_same_wave(one: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Whether another effect is accepted as a wave that the record cannot tell from this one's."""
    if one.cycles is None or one.field is None:
        return False
    waves = [its.cycles for its in accepted if its.cycles is not None and its.kind is not one.kind]
    return any(abs(its - one.cycles) * len(one.field) < 1.0 for its in waves)


def _coloured(accepted: Sequence[Candidate]) -> set[str]:
    """Names of single BPMs whose noise is told to remember."""
    return {name for one in accepted if one.coloured for name in one.names}


def _is_odd_noise(one: Candidate, drawn: bool) -> bool:
    """Whether it says no more than that noise is odd, as any law that is not known yet makes it.

    Args:
        one: In question.
        drawn: Whether readings were drawn, which have nothing of such a law.
    """
    return one.noisy and (drawn or one.courseless)


def _oddness(candidates: Sequence[Candidate], drawn: bool) -> float:
    """Evidence that noise is odd [nats]."""
    return max((one.evidence for one in candidates if _is_odd_noise(one, drawn)), default=0.0)


def _last_resort(candidates: list[Candidate], before: float | None, drawn: bool) -> list[Candidate]:
    """Tell that the noise of a BPM is unlike the others' only where nothing else is told.

    Whatever a BPM does that is in no law adds to its noise. Where readings were drawn, so does any
    law that is not known yet: nothing of it is in those. A random course is no such law, and how
    much the ground moves leaves a BPM as odd as it is. A law of other devices that makes a BPM odd
    says more than that it is, but for what the floor may have of the law; one of BPMs, told to
    first order, or of readings that were drawn without it at least a share. And beside one of them
    that was accepted a BPM is odd that was as odd before: what such a law leaves is a share.

    Args:
        candidates: The best first.
        before: How odd a BPM was before any law was accepted [nats]; None: no law is yet.
        drawn: Whether readings were drawn.
    """
    odd = _oddness(candidates, drawn)
    others = [one for one in candidates if not _is_odd_noise(one, drawn)]
    if before is not None:
        as_before = before > SURE and odd > before / SWALLOWED
        return candidates if as_before and not drawn else others
    told = [one for one in others if not (_of_ground(one) or (drawn and one.courseless))]
    if not told:
        return candidates
    share = REMAINDER if drawn or told[0].kind.target == "bpm" else 1.0 / SWALLOWED
    return others if told[0].evidence >= max(SURE, share * odd) else candidates


def _of_ground(one: Candidate) -> bool:
    """Whether it says only how much the ground moves."""
    return one.noisy and one.kind.target == "ring"


def _light(candidates: list[Candidate]) -> list[Candidate]:
    """Drop the fields of all but the finalists: each is as large as the record."""
    light = [replace(one, after=None) for one in candidates]
    rest = [replace(one, field=None, finer=None) for one in light[FINALISTS:]]
    return [*light[:FINALISTS], *rest]

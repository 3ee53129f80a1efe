"""What leads, weighed over floors that are estimated with each of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.device_by_device import device_by_device
from orbitfb.diagnose.selection.settled import settled
from orbitfb.estimation.priors import CLOSE, HEARD, LEADING, MISFIT, SURE, SWALLOWED


@dataclass(frozen=True, slots=True, eq=False)
class Weighing:
    """What leads, weighed.

    Args:
        candidates: The best first.
        bare: The workspace over the best floor without any of them.
        base: Log posterior over that; None: none of them had a floor of its own.
        lost: By how much it is likelier than the floor of the saturated model's rest [nats].
    """

    candidates: list[Candidate]
    bare: Workspace
    base: float | None = None
    lost: float = 0.0


def refitted(candidates: Sequence[Candidate], space: Workspace, enough: float = SURE) -> Weighing:
    """Compare those that lead under floors that are estimated with each of them.

    A floor that was estimated without a cause stands in for what the cause does as far as it can,
    and so do the healthy errors: what a law is worth beside it depends on that. Under floors of
    their own a law and a random course, a reversed sign and a walk, are weighed alike.

    A floor of its own is nearly the best that a candidate has. Another one hardly gives it more, so
    every floor that is estimated says of all of them how much they have at least: rivals of what
    leads, which no floor of all tells from it, show under its floor and get one of their own.

    It also says how likely the readings are with no cause at all: a saturated model may take up a
    cause, and the floor of what it leaves is then too low to be the best without one. All are
    weighed against the best of these floors.

    Args:
        candidates: The best first.
        space: That they were tried on.
        enough: Evidence from which one is accepted [nats].
    """
    # Noise has no floor of its own. Where it leads, a law whose course is told may be what is odd
    # in it; a random course would be as odd as the noise.
    coursed = bool(candidates) and candidates[0].noisy
    if not any(
        _is_weighed(one, coursed) and _at_most(one, one.evidence) >= enough for one in candidates
    ):
        return Weighing(list(candidates), space)
    candidates = [device_by_device(one, space) for one in candidates]
    space = space.saturable()
    # As often as with a cause: what a floor gains that was not at its best yet is of no cause.
    base, bare, lost = space.with_floor().log_posterior(), space, 0.0
    rivals = _Rivals(list(candidates), [one.evidence for one in candidates], enough, coursed)
    while (number := rivals.next()) is not None:
        own, after = settled(rivals.candidates[number], space, spread=False)
        less = base + (own.cost or 0.0)
        gain, best = after.log_posterior() - less, max(rivals.good(), default=0.0)
        # Both as they were before any floor without a cause was the best: it takes off all alike.
        near = gain + lost > (best + lost) / SWALLOWED
        for left in reversed(range(HEARD if near else 0)):
            nearer = after.with_floor()
            step = nearer.log_posterior() - less - gain
            if step < SURE:
                break
            gain, after = gain + step, nearer
            if gain + left * step < best:  # no turn gains more than the one before
                break
        rivals.weighed(number, replace(own, evidence=gain), after)
        if gain > best:
            rivals.late_as(own, over(space, after))
        if own.additive:
            lower = over(space, after)
            more = lower.log_posterior() - base
            rivals.least(_under(rivals.candidates, lower, more))
            if more > 0.0:
                base, bare, lost = base + more, lower, lost + more
                rivals.lose(more)
    return Weighing(rivals.ranked(), bare, base, lost)


def with_noise_after(
    best: Candidate, weighing: Weighing, rival: float, owed: float = 0.0
) -> Candidate:
    """The same with the noise of its BPMs after what they do, if that is likelier.

    Such a law is told from the predicted orbit, and so a little wrong. It is weighed only where an
    unknown law of BPMs, which has the noise after it, is likelier than the best with noise before.

    Args:
        best: The candidate that leads.
        weighing: It was weighed so.
        rival: Evidence of the best unknown law of BPMs [nats].
        owed: What all of them owe besides [nats].
    """
    if weighing.base is None or not best.takes_noise or rival <= best.evidence:
        return best
    after = replace(best, noise_after=True, after=None)
    own, space = settled(after, weighing.bare, spread=False)
    gain = space.log_posterior() - weighing.base - (own.cost or 0.0) - owed
    return replace(own, evidence=gain, after=space) if gain > best.evidence else best


@dataclass(slots=True)
class _Rivals:
    """The candidates of a round, and what is known of their evidence.

    Args:
        candidates: As they were scanned, the best first.
        worth: The most that each has under any floor so far [nats].
        enough: Evidence from which one is accepted [nats].
        coursed: Whether only those whose course is told are weighed.
        own: Those that were weighed under floors of their own, by number.
    """

    candidates: list[Candidate]
    worth: list[float]
    enough: float
    coursed: bool
    own: dict[int, Candidate] = field(default_factory=dict)

    def weighed(self, number: int, own: Candidate, after: Workspace) -> None:
        """Learn what one has over a floor of its own; the best keeps that floor.

        Args:
            number: Its number.
            own: With its evidence.
            after: With it, over that floor.
        """
        if own.evidence > max(self.good(), default=0.0):
            self.own = {other: replace(one, after=None) for other, one in self.own.items()}
            own = replace(own, after=after)
        self.own[number] = own

    def least(self, found: Mapping[int, float]) -> None:
        """Learn what some have at least [nats], by number."""
        for number, gain in found.items():
            self.worth[number] = max(self.worth[number], gain)

    def lose(self, nats: float) -> None:
        """Learn that no cause at all is likelier than it was thought to be, by so much."""
        self.worth = [worth - nats for worth in self.worth]
        self.own = {
            number: replace(one, evidence=one.evidence - nats) for number, one in self.own.items()
        }

    def late_as(self, own: Candidate, lower: Workspace) -> None:
        """Tell anew when other laws of the same devices begin, over the floor that one leaves.

        Args:
            own: The best so far, with a floor of its own; of one that does not begin late nothing
                is learnt.
            lower: Without it, over that floor.
        """
        if not own.onset:
            return
        scorer = Weighed.of(lower)
        for number, one in enumerate(self.candidates):
            late = one.onset > 0 and self.worth[number] > 0.0
            if number in self.own or not late or set(one.places) != set(own.places):
                continue
            fine = one if one.finer is None else one.finer()
            if fine.again is not None:
                more = fine.again(lower)
                cost = more.cost
                if cost is None:
                    cost = scorer.likelihood(np.asarray(more.field)) - more.evidence
                self.candidates[number] = replace(more, cost=cost)

    def next(self) -> int | None:
        """Number of the one that gets a floor of its own next; None: no other needs one."""
        good = self.good()
        best = max(good, default=0.0)
        least = CLOSE * best
        if len(good) >= LEADING:
            least = max(least, best - SURE * (1.0 + MISFIT * best))
        weighed = self._weighed()
        for number in np.argsort(-np.array(self.worth), kind="stable"):
            one = self.candidates[number]
            if not _is_weighed(one, self.coursed) or one.cost is None or number in self.own:
                continue
            form = _form(one)
            if form in weighed and (not one.additive or self.worth[number] <= weighed[form]):
                continue
            # Each BPM is the scale of what is undone: beside the floor of all it counts for little.
            at_it = _beside(one, self.candidates[0]) and one.evidence > 0.5 * self.enough
            more = _by_device(one) or self._begins_with_best(one)
            at_it = at_it or (self.worth[number] > 0.5 * best and more)
            at_it = at_it or (one.undone is not None and one.evidence > self.enough)
            enough = _at_most(one, self.worth[number]) >= self.enough
            if at_it or (enough and self.worth[number] > least):
                return int(number)
        return None

    def _begins_with_best(self, one: Candidate) -> bool:
        """Whether it begins at the same devices in the same row as the best: only floors tell."""
        best = max(self.own.values(), key=lambda its: its.evidence, default=one)
        return 0 < one.onset == best.onset and set(one.places) == set(best.places)

    def ranked(self) -> list[Candidate]:
        """All of them, the best first; of one without a floor of its own what it has at least.

        That is no more than its effect, or those that led, have; where it is as much, those that
        were weighed stand before it.
        """
        weighed, good = self._weighed(), min(self.good(), default=np.inf)
        found = list(self.own.values())
        for number, one in enumerate(self.candidates):
            if number not in self.own:
                most = one.evidence if one.noisy else weighed.get(_form(one), good)
                found.append(replace(one, evidence=min(self.worth[number], most)))
        return strongest(found)

    def good(self) -> list[float]:
        """Evidence of those that have a floor of their own, and are worth something [nats]."""
        return [one.evidence for one in self.own.values() if one.evidence > 0.0]

    def _weighed(self) -> dict[tuple[str, str], float]:
        """Evidence of every form of an effect that has a floor of its own."""
        found: dict[tuple[str, str], float] = {}
        for one in self.own.values():
            found[_form(one)] = max(one.evidence, found.get(_form(one), one.evidence))
        return found


def _is_weighed(one: Candidate, coursed: bool) -> bool:
    """Whether it may have a floor of its own: all but noise, or only what adds a course."""
    return one.additive if coursed else not one.noisy


def _at_most(one: Candidate, worth: float) -> float:
    """Evidence that it may have over a floor of its own [nats]: the other has half of what it adds.

    Args:
        one: The candidate.
        worth: Evidence that it has over the floor of all [nats].
    """
    added = worth + (one.cost or 0.0)
    return worth + (SWALLOWED - 1.0) * max(added, 0.0)


def _form(one: Candidate) -> tuple[str, str]:
    """Its effect, and as what: larger errors of all or of some, a random course, or one told.

    What is told device by device, over a floor of its own only, all and some of them tell unlike.
    """
    if one.raised or one.columns:
        return (one.kind.id, "all" if one.raised else "some")
    if _by_device(one):
        return (one.kind.id, "some by device" if one.places else "all by device")
    if one.undone is not None and one.onset:  # each BPM is its own scale, and its last rows tell it
        return (one.kind.id, "late")
    return (one.kind.id, "told" if one.walk is None else "random")


def _by_device(one: Candidate) -> bool:
    """Whether states and values are told device by device, over a floor of its own only."""
    return one.kind.remembers and one.again is not None


def _under(candidates: Sequence[Candidate], lower: Workspace, more: float) -> dict[int, float]:
    """Evidence of all that add a course over the floor that one of them leaves [nats], by number.

    Args:
        candidates: Of the round.
        lower: Over that floor, without any of them.
        more: What it is likelier than the best floor without any, so far [nats].
    """
    scorer = Weighed.of(lower)
    found = {}
    for number, one in enumerate(candidates):
        if one.additive and one.field is not None and one.cost is not None:
            found[number] = more + scorer.likelihood(one.field) - one.cost
    return found


def _beside(one: Candidate, best: Candidate) -> bool:
    """Whether the best says of a device of it, or of its place, only that its course is odd.

    Whatever that device does is a random course to a floor that was estimated without it.
    """
    ring = one.kind is best.kind and not one.names and not best.names
    return best.courseless and (ring or not set(one.names).isdisjoint(best.names))

"""Forward selection: accept the best cause, judge the record with it, look again, fit jointly."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import Budget
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.deafened import without_bpms
from orbitfb.diagnose.entry import HOPELESS, Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.moved_alone import moved_alone
from orbitfb.diagnose.noise_modes import Ground
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.restless import restless
from orbitfb.diagnose.rounds import Round, least_weight, winner
from orbitfb.diagnose.second_order import second_order
from orbitfb.diagnose.strikes import without_strikes
from orbitfb.diagnose.switching import without_switching
from orbitfb.diagnose.together import looked_at_again, same, without_void
from orbitfb.diagnose.tournament import Shown, tournament
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.records.record import Record

MOST_CAUSES = 3


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What a search found.

    Args:
        rounds: One more than causes, unless the most causes were found.
        joint: All causes with a course in time fitted together on the nominal bench; None when
            there are none.
        bench: The record under all causes, with the floor that they leave.
        causes: With their values.
        cut: What there was no time for, in words; empty when everything was done.
        given: What the causes that were known from the beginning are worth [nats]; 0: none were.
    """

    rounds: tuple[Round, ...]
    joint: Fit | None
    bench: Bench
    causes: tuple[Cause, ...] = field(default=())
    cut: str = ""
    given: float = 0.0

    @property
    def winners(self) -> tuple[Round, ...]:
        """Rounds that accepted a cause."""
        return tuple(one for one in self.rounds if one.accepted is not None)

    @property
    def sure(self) -> bool:
        """Whether the first cause is surely there."""
        return bool(self.winners) and self.winners[0].sure

    @property
    def hopeful(self) -> frozenset[str]:
        """Ids of what more rows may make sure of, and of what is confused with it."""
        first = self.rounds[0]
        needed = least_weight(first.kinds, further=self.given > 0.0)
        able = [entry.kind for entry in first.entries if entry.weight > HOPELESS * needed]
        return frozenset(name for kind in able for name in (kind.id, *kind.confused_with))

    def late(self, row: int, rows: int) -> list[Candidate]:
        """Give what was found in the end of a record as what begins there.

        A scan for late effects knows their values from the whole record, where these may be others.

        Args:
            row: At which the end begins.
            rows: Of the whole record.
        """
        entries = [one.accepted for one in self.winners if one.accepted is not None]
        return [
            replace(
                entry.candidate,
                cause=replace(entry.cause, onset=row + entry.cause.onset),
                choices=entry.candidate.choices * (1.0 if entry.cause.onset else rows),
            )
            for entry in entries
            if entry.fit is not None and entry.kind.sudden and not entry.kind.grows
        ]

    def final(self, entry: Entry) -> tuple[Cause, Fit | None]:
        """Give an accepted cause with its values of the joint fit, if it has a course in time."""
        for cause in () if self.joint is None else self.joint.causes:
            if same(cause, entry.cause):
                return cause, self.joint
        return entry.cause, entry.fit


def search(
    record: Record,
    kinds: Sequence[EffectKind],
    floor: NoiseFloor | None = None,
    given: Sequence[Cause] = (),
    progress: Progress | None = None,
    budget: Budget | None = None,
    shown: Shown = frozenset(),
    *,
    beside: bool = False,
    also: Sequence[Candidate] = (),
    ground: Ground | None = None,
    others: int = 0,
) -> Outcome:
    """Find the causes of a record's gap.

    Args:
        record: What happened.
        kinds: That it can show.
        floor: Of a reference record; estimated with the record when None.
        given: Causes without a size that are known to be there.
        progress: Told what is done and which share of all.
        budget: Time for it; None: all there is.
        shown: What the readbacks show.
        beside: Whether there are causes that are known and have been taken out of the record.
        also: Candidates that compete beside those of the scan, first of all.
        ground: How the quadrupoles move; None: as the record says.
        others: Further kinds that the record can show, but of which a part of it showed nothing.
    """
    budget = budget or Budget(np.inf)
    tell = progress or (lambda what, share: None)
    nominal = second_order(Bench(record, given, floor, ground=ground))
    worth = _worth(nominal, floor) if given else 0.0
    bench = heard = nominal
    rounds: list[Round] = []
    causes: tuple[Cause, ...] = ()
    left = list(kinds)

    def under(causes: Sequence[Cause]) -> Bench:
        told = floor if nominal.told_floor else None
        return Bench(nominal.record, (*given, *causes), told, nominal.floor.modes)

    for number in range(MOST_CAUSES + 1):
        share = number / (MOST_CAUSES + 1)
        if rounds and budget.over():
            budget.leave("no further cause was looked for")
            break
        entries = tournament(
            bench,
            left,
            lambda what, s, share=share: tell(what, share + s / (MOST_CAUSES + 1)),
            budget,
            shown,
            least_weight(len(left) + others, further=bool(beside or given or rounds)),
            () if rounds else also,
        )
        one = Round(bench, tuple(entries), len(left) + others, None, budget.taken())
        best = winner(one, rounds, worth, beside=beside) if number < MOST_CAUSES else None
        if not rounds and not budget.over():
            other = restless(bench, best)
            if other is not None or moved_alone(bench, tuple(given), best):
                calm = "alone" if other is None else ground
                return search(
                    record if other is None else other, kinds, floor, given, progress, budget,
                    shown, beside=beside, also=also, ground=calm, others=others,
                )  # fmt: skip
        rounds.append(replace(one, accepted=best))
        if best is None:
            break
        causes = (*causes, best.cause)
        if best.fit is None:
            # It has no law in time: what it did is taken out of the record, where that is known.
            if (deaf := without_bpms(bench, best.cause)) is not None:
                nominal = Bench(deaf[0], given, None, deaf[1])
            elif (cleaned := _cleaned(bench, best.cause)) is not None:
                told = floor if nominal.told_floor else None
                clean = Bench(cleaned, given, told, nominal.floor.modes)
                nominal, heard = clean, clean if heard is nominal else heard
                left = [kind for kind in left if not _kin(kind, best.kind)]
            else:
                break  # the floor does not have it, so that what is left is its own doing first
        bench = under(_moving(causes))
    rounds, joint, moving = without_void(nominal, bench, rounds)

    def beside_others(known: tuple[Cause, ...], also: Sequence[Candidate]) -> Round:
        own, least = under(known), least_weight(len(left) + others, further=True)
        entries = tournament(own, left, None, budget, shown, least, also)
        return Round(own, tuple(entries), len(left) + others, None, budget.taken())

    if (again := looked_at_again(rounds, moving, beside_others, budget)) != rounds:
        rounds, joint, moving = without_void(nominal, bench, again)
    causes = tuple(one.accepted.cause for one in rounds if one.accepted is not None)
    final = heard  # with the BPMs that were left out of the search
    if moving:
        final = Bench(heard.record, (*given, *moving), floor, heard.floor.modes)
    still = [cause for cause in causes if isinstance(cause.kind, LatentKind | NoiseKind)]
    tell("done", 1.0)
    untried = dict.fromkeys(c.cause.kind.id for one in rounds for c in one.untried)
    cut = budget.told([*untried])
    return Outcome(tuple(rounds), joint, final, (*given, *moving, *still), cut, worth)


def _worth(bench: Bench, floor: NoiseFloor | None) -> float:
    """What the causes of a bench are worth [nats].

    What the screen is certain of throws the orbit far off, and healthy errors with it.
    """
    without = Bench(bench.record, (), floor, bench.floor.modes)
    return max(bench.full_log_likelihood - without.full_log_likelihood, 0.0)


def _kin(kind: EffectKind, taken: EffectKind) -> bool:
    """Whether a kind would show in what is left of one without a law that was taken out."""
    if isinstance(taken, LatentKind):
        return isinstance(kind, LatentKind | NoiseKind)
    return isinstance(kind, NoiseKind) and kind.colour == "walk"


def _cleaned(bench: Bench, cause: Cause) -> Record | None:
    """The record without what a cause without a law in time did; None where that is not known."""
    kind = cause.kind
    if isinstance(kind, LatentKind) and kind.strength != "normal":
        return without_strikes(bench, kind, cause)
    return without_switching(bench, cause)


def _moving(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Causes with a course in time."""
    return tuple(c for c in causes if not isinstance(c.kind, LatentKind | NoiseKind))

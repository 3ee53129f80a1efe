"""One tournament of a search: what competed, how likely each kind is, which of them is accepted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.departure import departure
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.same_law import devices
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

SURE = 0.99
"""Probability that there is something of a kind at which it is accepted.

On a record without a gap a Bayes factor of 99 comes up at most once in a hundred times (Markov's
inequality), whatever the prior is worth.
"""
LIKELY = 0.9
"""The same at which the record is said to show it or nothing: `ambiguous`, never a name."""
CLOSE = 5.0
"""Kinds whose weights differ by less cannot be told apart [nats] (evidence 150 to 1)."""

_FURTHER = 0.05
"""Share of the weight of the causes so far that a further one must have."""
_FURTHER_BESIDE_LAWS = 0.005
"""The same where those are seen to act just as their laws say."""
_LEAST_FURTHER = 15.0
"""Least weight of a further cause [nats]: the first one is never quite right."""
_TIDY = 1.5
"""Scatter of a further cause's scores over what the noise model says that is still tidy."""

_AS_MUCH = 1.0
"""Two causes explain as much when their gains differ by less, and one has more values [nats]."""


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One tournament.

    Args:
        bench: The record under the causes accepted before.
        entries: Best first.
        kinds: How many kinds competed.
        accepted: The winner; None when none was sure enough.
        untried: Causes that there was no time to fit; what the scan thinks of them counts.
    """

    bench: Bench
    entries: tuple[Entry, ...]
    kinds: int
    accepted: Entry | None
    untried: tuple[Candidate, ...] = ()

    def probabilities(self) -> dict[str, float]:
        """Posterior probability of every kind that was fitted; the rest is "none of them".

        Before the data no effect at all is as likely as any effect, and all kinds are alike.
        """
        weights: dict[str, float] = {}
        for entry in self.entries:
            before = weights.get(entry.kind.id, -np.inf)
            weights[entry.kind.id] = float(np.logaddexp(before, entry.weight))
        for candidate in self.untried:
            name, promise = candidate.cause.kind.id, candidate.gain - np.log(candidate.choices)
            weights[name] = float(np.logaddexp(weights.get(name, -np.inf), promise))
        ids = list(weights)
        logs = np.array([0.0, *(weights[name] - np.log(self.kinds) for name in ids)])
        shares = np.exp(logs - np.logaddexp.reduce(logs))
        return dict(zip(ids, shares[1:].tolist(), strict=True))

    @property
    def sure(self) -> bool:
        """Whether something is surely there."""
        return sum(self.probabilities().values()) >= SURE

    def rivals(self) -> list[Entry]:
        """Best entries of the other kinds that the record cannot tell from the winner."""
        if self.accepted is None:
            return []
        found: dict[str, Entry] = {}
        for entry in self.entries:
            near = self.accepted.weight - entry.weight < CLOSE
            if near and not entry.limit_of and entry.kind.id != self.accepted.kind.id:
                found.setdefault(entry.kind.id, entry)
        return list(found.values())

    def limits(self) -> tuple[str, ...]:
        """Effects that amount to the winner here, or explain as much at the same devices.

        Nothing but the number of their parameters, or what all of a kind pay for the choice of
        their places, speaks against these.
        """
        best = self.accepted
        if best is None:
            return ()
        found = (
            entry.kind.id
            for entry in self.entries
            if entry.limit_of == best.kind.id or self._as_much(entry, best)
        )
        return tuple(dict.fromkeys(found))

    def _as_much(self, entry: Entry, best: Entry) -> bool:
        """Whether another effect explains as much at the same devices."""
        layout = self.bench.record.layout
        here = devices(best.cause, layout)
        if entry.kind.id == best.kind.id or devices(entry.cause, layout) != here:
            return False
        more = entry.size > best.size
        return entry.gain > best.gain - (_AS_MUCH if more else CLOSE)

    def alike(self) -> tuple[str, ...]:
        """Effects that the winner may be instead: its rivals, and what amounts to it here."""
        rivals = (rival.kind.id for rival in self.rivals())
        return tuple(dict.fromkeys((*rivals, *self.limits())))

    def places_within(self) -> list[Entry]:
        """Other places of the winner's kind that the record cannot exclude."""
        best = self.accepted
        if best is None:
            return []
        return [
            entry
            for entry in self.entries
            if entry.kind.id == best.kind.id
            and entry.cause.places != best.cause.places
            and len(entry.cause.places) == len(best.cause.places)
            and best.weight - entry.weight < CLOSE
        ]


def least_weight(kinds: int, *, further: bool) -> float:
    """Weight that the best of so many kinds needs to be accepted, if there is nothing else [nats].

    Args:
        kinds: That compete.
        further: Whether causes are known already.
    """
    likely = float(np.log(kinds * LIKELY / (1.0 - LIKELY))) if kinds else 0.0
    return _LEAST_FURTHER if further else likely


def winner(
    one: Round, before: Sequence[Round], given: float = 0.0, *, beside: bool = False
) -> Entry | None:
    """The best entry, if something of its kind (or of a close one) is likely to be there.

    A further cause must be sure. It must not be what the first ones left because they are not
    quite right: it has to be worth a share of what they are, less of it where no other law of
    their devices does better, and its scores must scatter as the noise model says.

    Args:
        one: The tournament.
        before: Those before it.
        given: What the causes that were known from the beginning are worth [nats]; 0: none were.
        beside: Whether there are others that are known and have left no trace in what competes.
    """
    if not one.entries:
        return None
    best = one.entries[0]
    further = beside or given > 0.0 or bool(before)
    least = SURE if further else LIKELY
    if best.held_out <= 0.0 or sum(one.probabilities().values()) < least:
        return None
    if not further:
        return best
    scatter = 1.0 if best.fit is None else best.fit.inflation
    if scatter > _TIDY or best.weight < _LEAST_FURTHER:
        return None
    accepted = [r.accepted for r in before if r.accepted is not None]
    earlier = given + sum(entry.weight for entry in accepted)
    share = best.weight / max(earlier, best.weight)
    if share > _FURTHER:
        return best
    if share > _FURTHER_BESIDE_LAWS and all(_lawful(one.bench, entry) for entry in accepted):
        return best
    return None


def _lawful(bench: Bench, entry: Entry) -> bool:
    """Whether no other law of an accepted cause's devices explains what it leaves."""
    if isinstance(entry.kind, LatentKind | NoiseKind):
        return False
    return not departure(bench, entry.cause, entry.gain).course

"""What every cause is worth: its share of the gain, what is lost without it, what each leaves."""

from collections.abc import Sequence
from itertools import combinations
from math import factorial

import numpy as np

from orbitfb.diagnose.answer_blocks import WaterfallStep
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.contrast import Contrast
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.replay import Model, Replay
from orbitfb.diagnose.search import Outcome
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

_MANY = 5


class Gains:
    """Log-likelihood of a record under some of its causes, at their fitted values.

    Floor and healthy errors are those that all causes together leave.

    Args:
        bench: The record under all its causes.
    """

    def __init__(self, bench: Bench) -> None:
        self.causes = bench.causes
        self._replay = Replay.of(bench)
        self._counted = self._replay.counted()
        self._known: dict[tuple[int, ...], float] = {}

    @property
    def ticks(self) -> int:
        """Rows that count."""
        return max(int(self._counted.sum()), 1)

    def of(self, members: Sequence[int]) -> float:
        """Log-likelihood with these causes and no other [nats].

        Args:
            members: Positions among the causes of the bench.
        """
        key = tuple(sorted(members))
        if key not in self._known:
            model = Model(tuple(self.causes[index] for index in key))
            white = self._replay.white(model)[self._counted]
            jacobian = float(np.sum(self._replay.jacobian(model)))
            self._known[key] = jacobian - 0.5 * float(np.sum(white**2))
        return self._known[key]

    def steps(self) -> list[float]:
        """What every cause adds to those before it [nats]."""
        return [float(s) for s in np.diff([self.of(range(k)) for k in range(len(self.causes) + 1)])]


def shapley(gains: Gains) -> list[float]:
    """Give every cause its share of the gain of all, whatever the order [nats].

    The mean over all orders of what a cause adds to those before it (L. S. Shapley, 1953), at the
    fitted values; beyond five causes, in the order in which they were found.

    Args:
        gains: Of the record.
    """
    count = len(gains.causes)
    if count > _MANY:
        return gains.steps()
    shares = [0.0] * count
    for index in range(count):
        others = [other for other in range(count) if other != index]
        for size in range(count):
            weight = factorial(size) * factorial(count - size - 1) / factorial(count)
            for members in combinations(others, size):
                shares[index] += weight * (gains.of((*members, index)) - gains.of(members))
    return shares


class Worths:
    """What the causes of a search are worth, one by one.

    Args:
        outcome: Of the search.
        gains: Of its last bench.
    """

    def __init__(self, outcome: Outcome, gains: Gains) -> None:
        self._outcome = outcome
        self._bench = outcome.bench
        self._shares = shapley(gains)
        unseen = [e.candidate.gain for e in random_entries(outcome)]
        self._total = float(sum(self._shares) + sum(unseen))

    def share(self, cause: Cause, entry: Entry) -> float | None:
        """Share of the gain of all causes [1]; None where they gain nothing."""
        if not self._total > 0.0:
            return None
        index = self._index(cause)
        gained = entry.candidate.gain if index is None else self._shares[index]
        return gained / self._total

    def lost_without(self, cause: Cause, entry: Entry) -> float | None:
        """Loss of log-likelihood when it alone is left out [nats].

        The other causes keep their values; the healthy errors are fitted anew.
        """
        index = self._index(cause)
        if index is None:
            return entry.candidate.gain if entry.fit is None else None
        base = self._base()
        given = len(base.causes)
        if index < given:
            return None
        moving = self._bench.causes[given:]
        rest = tuple(one for one in moving if one is not cause)
        whole = log_likelihood(*base.residual(moving))
        return whole - log_likelihood(*base.residual(rest))

    def _index(self, cause: Cause) -> int | None:
        for index, own in enumerate(self._bench.causes):
            if own is cause:
                return index
        return None

    def _base(self) -> Bench:
        """The nominal model under the floor of all causes."""
        first, last = self._outcome.rounds[0].bench, self._bench
        if first.record is last.record:
            return first.with_floor(last.floor)
        return Bench(last.record, first.causes, last.floor, last.floor.modes, last.scale)


def random_entries(outcome: Outcome) -> list[Entry]:
    """List the accepted effects without a course in time."""
    accepted = [one.accepted for one in outcome.winners if one.accepted is not None]
    return [entry for entry in accepted if isinstance(entry.kind, NoiseKind | LatentKind)]


def waterfall(
    outcome: Outcome, gains: Gains, nats_per_tick: float | None, compared: Contrast | None
) -> tuple[WaterfallStep, ...]:
    """Tell what is left of the gap as one cause after the other joins the model.

    Args:
        outcome: Of the search.
        gains: Of its last bench.
        nats_per_tick: The gap of the nominal model on the data of the fit.
        compared: On data used for nothing else; None where there are none. There effects
            without a course in time have no likelihood of their own, and nothing is told.
    """
    unseen = random_entries(outcome)
    if nats_per_tick is None or not (gains.causes or unseen):
        return ()
    held = [] if compared is None else _held_out(compared)
    steps = [WaterfallStep(label="nominal", fit=nats_per_tick, held_out=held[0] if held else None)]
    left = nats_per_tick
    for index, (cause, gained) in enumerate(zip(gains.causes, gains.steps(), strict=True)):
        left -= gained / gains.ticks
        there = held[index + 1] if held else None
        steps.append(WaterfallStep(label=f"+ {cause.kind.id}", fit=left, held_out=there))
    for entry in unseen:
        left -= entry.candidate.gain / gains.ticks
        steps.append(WaterfallStep(label=f"+ {entry.kind.id}", fit=left))
    return tuple(steps)


def _held_out(compared: Contrast) -> list[float]:
    """Gap of the nominal model and of every step towards the one with all causes [nats/tick]."""
    causes = compared.model.causes
    ladder = [
        float(compared.likelihood(Model(causes[:count]))[0]) for count in range(len(causes) + 1)
    ]
    whole = max(ladder[-1] + float(compared.distance(compared.mine)[0]), 0.0)
    return [whole - gained for gained in ladder]

"""Laws of two devices: exchanged, coupled, rolled."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.pairs import LatePair, kicking_pairs
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import grown_apart
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import PairLaw
from orbitfb.estimation.evidence import NormalTerms, given_size, normal_size
from orbitfb.estimation.priors import (
    MOST_DEVICES,
    ONSET_MARGIN,
    SIZE_WIDTH,
    SURE,
    VALUE_COST,
    WIDTHS,
)
from orbitfb.estimation.transform import Indices, Matrix

_LATE = 2
"""Pairs whose row is told, those of which most shows. By hand, for time."""


@dataclass(frozen=True, slots=True, eq=False)
class _Mixed:
    """A law of pairs at given values: each pair adds two columns, which share one size.

    Args:
        kind: The effect.
        law: Its law.
        values: Of its parameters.
        mixing: Of every pair, shape (P, 2, 2).
    """

    kind: EffectKind
    law: PairLaw
    values: Values
    mixing: Matrix

    def told(self, scorer: Scorer, numbers: Indices) -> tuple[Vector, Matrix]:
        """Pull (k,) and information (k, k) of pairs, healthy errors marginalised."""
        columns = self.law.pairs[numbers]
        patterns = [self.law.patterns[:, columns[:, side]] for side in range(2)]
        courses = [
            np.einsum("npl,pl->np", self.law.courses[:, columns], self.mixing[numbers, side])
            for side in range(2)
        ]
        spectrum = scorer.space.transform.quick_spectrum(np.hstack(courses))
        return scorer.columns(patterns, spectrum)

    def one(self, space: Workspace, number: int, size: float) -> Candidate:
        """A pair with a size, not weighed."""
        law, pair = self.law, self.law.pairs[number]
        field = space.transform.spectrum(law.courses[:, pair] @ self.mixing[number].T)
        scaled = {**self.values, **{p.name: size * self.values[p.name] for p in self.kind.sizes}}
        struck = law.struck[number]
        names = tuple(law.names[place] for place in struck)
        back = law.mixing(scaled)[number]
        wider = float(np.linalg.slogdet(np.eye(2) - back)[1])

        def undo(its: Workspace) -> tuple[Matrix, float]:
            change = its.transform.spectrum(law.courses[:, pair] @ back.T)
            return change @ law.patterns[:, pair].T, wider * len(its.transform)

        def drives() -> Matrix:
            change = np.zeros_like(law.courses)
            change[:, pair] = size * law.courses[:, pair] @ self.mixing[number].T
            return change

        return Candidate(
            self.kind, struck, names, scaled, 0.0, field=size * field @ law.patterns[:, pair].T,
            drives=None if law.readings else drives, undone=undo if law.readings else None,
        )  # fmt: skip

    def several(
        self, space: Workspace, numbers: Indices, sizes: Vector, evidence: float
    ) -> Candidate:
        """Pairs with sizes, as one candidate; empty places where they are all pairs there are."""
        parts = [
            self.one(space, int(number), float(size))
            for number, size in zip(numbers, sizes, strict=True)
        ]
        whole = 1 < len(parts) == len(self.law.pairs)
        rms = {
            p.name: float(np.sqrt(np.mean(sizes**2))) * self.values[p.name] for p in self.kind.sizes
        }

        def undo(its: Workspace) -> tuple[Matrix, float]:
            undone = [one.undone(its) for one in parts if one.undone is not None]
            return np.sum([field for field, _ in undone], axis=0), sum(wider for _, wider in undone)

        def drives() -> Matrix:
            return np.sum([one.drives() for one in parts if one.drives is not None], axis=0)

        def again(its: Workspace) -> Candidate:
            pull, information = self.told(Scorer.of(its), numbers)
            more = NormalTerms(pull, information, np.full(len(numbers), SIZE_WIDTH**2)).mean()
            return self.several(space, numbers, sizes + more, evidence)

        readings = self.law.readings
        return Candidate(
            self.kind,
            () if whole else tuple(place for one in parts for place in one.places),
            () if whole else tuple(name for one in parts for name in one.names),
            {**self.values, **rms} if whole else parts[0].values,
            evidence,
            field=np.sum([np.asarray(one.field) for one in parts], axis=0),
            drives=None if readings else drives,
            undone=undo if readings else None,
            parts=tuple(parts) if len(parts) > 1 else (),
            again=again if readings and self.kind.sizes else None,
        )

    def late(self, number: int) -> LatePair:
        """A pair that begins late."""
        return LatePair(self.kind, self.law, self.values, number, self.mixing[number])

    def weighed(self, scorer: Scorer, numbers: Indices, sizes: Vector, cost: float) -> Candidate:
        """The same, with the evidence that they have.

        Args:
            scorer: Of what is left to explain.
            numbers: Of the pairs, shape (k,).
            sizes: Of them, shape (k,).
            cost: What the log likelihood is more than the evidence [nats].
        """
        one = self.several(scorer.space, numbers, sizes, 0.0)
        evidence = scorer.likelihood(np.asarray(one.field)) - cost
        return replace(self.several(scorer.space, numbers, sizes, evidence), cost=cost)


@dataclass(frozen=True, slots=True, eq=False)
class _Top:
    """Pairs that show most, weighed beside the healthy errors of all devices.

    Without these a large effect of a given size has far more information than pull, and of any size
    a neighbour of the true pair may have as much as that.

    Args:
        numbers: Of the pairs, shape (k,).
        pull: Of them, the errors marginalised, shape (k,).
        information: Of them, shape (k, k).
    """

    numbers: Indices
    pull: Vector
    information: Matrix

    @classmethod
    def of(cls, mixed: _Mixed, scorer: Scorer, shown: Vector) -> "_Top":
        """Weigh those of which most is shown, shape (P,)."""
        most = max(MOST_DEVICES, len(mixed.law.patterns))
        numbers = np.argsort(-shown, kind="stable")[:most]
        return cls(numbers, *mixed.told(scorer, numbers))

    def best(self, free: bool) -> int:
        """Number of that with most evidence, of any size or of the given one."""
        information = np.maximum(np.diag(self.information), 0.0)
        if free:
            return int(self.numbers[np.argmax(normal_size(self.pull, information, SIZE_WIDTH**2))])
        return int(self.numbers[np.argmax(given_size(self.pull, information))])


def scan_pairs(kind: EffectKind, law: PairLaw, scorer: Scorer) -> list[Candidate]:
    """Find the best pair of a law, from all products of patterns and courses at once.

    Where each pair may have a size of its own, the best set of pairs stands beside it.
    """
    if not len(law.pairs):
        return []
    space = scorer.space
    spectrum = space.transform.quick_spectrum(law.courses)
    pulls = ((scorer.pulled @ law.patterns).astype(np.float32).T @ spectrum).astype(np.float64)
    best: list[Candidate] = []
    sets: list[Candidate] = []
    for values in space.courses.grid(kind):
        mixed = _Mixed(kind, law, values, law.mixing(values))
        pull, information = _pair_scores(law, scorer, spectrum, pulls, mixed.mixing)
        free = bool(kind.sizes)
        gain = (
            normal_size(pull, information, SIZE_WIDTH**2) if free else given_size(pull, information)
        )
        number, top = int(np.argmax(gain)), None
        if free or float(pull.max(initial=0.0)) >= SURE:
            top = _Top.of(mixed, scorer, gain if free else pull)
            number = top.best(free)
        best.append(_single(mixed, scorer, number, free))
        if free and top is not None:
            sets += _sets(mixed, scorer, top)
        if not law.readings:
            shown = normal_size(pull, information, SIZE_WIDTH**2)
            shown[number] = max(shown[number], best[-1].evidence)
            sets += _late(mixed, scorer, shown)
    return [max(best, key=lambda one: one.evidence), *sets]


def _single(mixed: _Mixed, scorer: Scorer, number: int, free: bool) -> Candidate:
    """A pair, weighed."""
    plain = mixed.one(scorer.space, number, 1.0)
    pull, information = scorer.evaluate([np.asarray(plain.field)])
    size, gain = 1.0, float(given_size(pull, information[0])[0])
    if free:
        gain = float(normal_size(pull, information[0], SIZE_WIDTH**2)[0])
        size = float(pull[0] / (information[0, 0] + SIZE_WIDTH**-2))
    cost = float(np.log(len(mixed.law.pairs))) + VALUE_COST * len(mixed.kind.parameters)
    return mixed.several(scorer.space, np.array([number]), np.array([size]), gain - cost)


def _late(mixed: _Mixed, scorer: Scorer, shown: Vector) -> Iterator[Candidate]:
    """Pairs that begin late: those that show most over the whole record, or where they begin.

    Args:
        mixed: The law.
        scorer: Of what is left to explain.
        shown: Log evidence of every pair with a size of its own, shape (P,): of what begins late a
            part shows.
    """
    rows = range(ONSET_MARGIN, scorer.space.transform.rows - ONSET_MARGIN)
    if not len(rows):
        return
    for number, row in kicking_pairs(mixed.law, mixed.mixing, scorer):
        near = range(max(row - 1, rows.start), min(row + 2, rows.stop))
        if len(near):
            yield mixed.late(number).told(scorer, near)
    for number in np.argsort(-shown)[:_LATE].tolist():
        worth = float(shown[number]) - float(np.log(len(shown)))
        if worth > SURE:
            coarse = mixed.several(scorer.space, np.array([number]), np.ones(1), worth)
            # Looked at in every row only if it may lead: that takes as long as many laws.
            yield replace(coarse, field=None, finer=partial(mixed.late(number).told, scorer, rows))


def _sets(mixed: _Mixed, scorer: Scorer, several: "_Top") -> Iterator[Candidate]:
    """The best set of pairs, and all pairs, each with a size of its own."""
    top, count = several.numbers, len(mixed.law.pairs)
    cost = VALUE_COST * len(mixed.kind.parameters)

    def sized(chosen: Indices, width: float) -> NormalTerms:
        variance = np.full(len(chosen), width**2)
        inner = several.information[np.ix_(chosen, chosen)]
        return NormalTerms(several.pull[chosen], inner, variance)

    choice = float(np.log(count))
    found, evidence = grown_apart(several.pull, several.information, choice, True)
    if len(found) > 1:
        chosen = np.array(found)
        terms = sized(chosen, SIZE_WIDTH)
        whole = cost + choice * len(found) + terms.cost(terms.mean())
        yield mixed.weighed(scorer, top[chosen], terms.mean(), whole)
    if 1 < len(top) == count:
        every = np.arange(len(top))
        best, width = max((sized(every, one).evidence(), one) for one in WIDTHS)
        if best > evidence:
            terms = sized(every, width)
            yield mixed.weighed(scorer, top, terms.mean(), cost + terms.cost(terms.mean()))


def _pair_scores(
    law: PairLaw, scorer: Scorer, spectrum: Single, pulls: Matrix, mixing: Matrix
) -> tuple[Vector, Vector]:
    """Pull and information of every pair, shape (P,) each."""
    pairs = law.pairs
    pull = np.zeros(len(pairs))
    for row in range(2):
        for column in range(2):
            pull += mixing[:, row, column] * pulls[pairs[:, row], pairs[:, column]]
    space = scorer.space
    precision = space.noise.precision(space.transform, law.patterns)
    information = np.zeros(len(pairs))
    for band, weight in enumerate(precision):
        rows = space.transform.members(band)
        gram = (spectrum[rows].T @ spectrum[rows]).astype(np.float64)
        information += _quadratic(weight, gram, pairs, mixing)
    return pull, information


def _quadratic(weight: Matrix, gram: Matrix, pairs: Indices, mixing: Matrix) -> Vector:
    total = np.zeros(len(pairs))
    for k in range(2):
        for l in range(2):  # noqa: E741
            for p in range(2):
                for q in range(2):
                    total += (
                        mixing[:, k, l]
                        * mixing[:, p, q]
                        * weight[pairs[:, k], pairs[:, p]]
                        * gram[pairs[:, l], pairs[:, q]]
                    )
    return total

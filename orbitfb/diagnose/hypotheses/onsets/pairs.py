"""Pairs of correctors that are exchanged, coupled or rolled from a row on."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import any_size
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import PairLaw
from orbitfb.estimation.evidence import best_size, given_size
from orbitfb.estimation.priors import (
    ONSET_MARGIN,
    ONSETS_EVERY,
    SIZE_WIDTH,
    SURE,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix

_JUMPS = 4
"""Rows at which pairs are looked for by what they kick at once, at most. By hand, for time."""

_AT_ONCE = 250
"""Rows that are weighed at once. By hand, for memory."""


@dataclass(frozen=True, slots=True, eq=False)
class LatePair:
    """A pair at given values that begins late.

    Its currents are what they are: at the row at which it begins all of it comes at once, so a row
    beside that is another law, and every one is tried.

    Args:
        kind: The effect.
        law: Its law.
        values: Of its parameters.
        number: Of the pair.
        mixing: Of it, shape (2, 2).
    """

    kind: EffectKind
    law: PairLaw
    values: Values
    number: int
    mixing: Matrix

    def by_row(self, scorer: Scorer, rows: Sequence[int]) -> Vector:
        """Evidence of its beginning at some rows, but for what the choice costs, shape (R,)."""
        pair = self.law.pairs[self.number]
        mixed = self.law.courses[:, pair] @ self.mixing.T
        begun = np.arange(len(mixed))[:, None, None] >= np.array(rows)[None, :, None]
        courses = np.where(begun, mixed[:, None, :], 0.0).reshape(len(mixed), -1)
        spectrum = scorer.space.transform.quick_spectrum(courses)
        pull, information = scorer.each(self.law.patterns[:, pair], spectrum)
        worth = any_size if self.kind.sizes else given_size
        return worth(pull, information)

    def told(self, scorer: Scorer, rows: Sequence[int]) -> Candidate:
        """The pair at that of some rows from which it shows most."""
        gain = [
            self.by_row(scorer, rows[at : at + _AT_ONCE]) for at in range(0, len(rows), _AT_ONCE)
        ]
        return self.at(scorer, rows[int(np.argmax(np.concatenate(gain)))])

    def at(self, scorer: Scorer, row: int) -> Candidate:
        """The pair from a row on."""
        law, kind, pair = self.law, self.kind, self.law.pairs[self.number]
        space = scorer.space
        late = (np.arange(space.transform.rows) >= row)[:, None]
        course = np.where(late, law.courses[:, pair] @ self.mixing.T, 0.0)
        field = space.transform.spectrum(course) @ law.patterns[:, pair].T
        pull, information = scorer.evaluate([field])
        size, gain = 1.0, float(given_size(pull, information[0])[0])
        if kind.sizes:
            size = float(best_size(pull, information[0], SIZE_WIDTH**2)[0])
            gain = float(any_size(pull, information[0])[0])
        worth = float(pull[0] * size - 0.5 * information[0, 0] * size**2)
        chosen = float(np.log(len(law.pairs) * space.transform.rows))
        evidence = gain - chosen - VALUE_COST * len(kind.parameters)
        struck = law.struck[self.number]

        def drives() -> Matrix:
            change = np.zeros_like(law.courses)
            change[:, pair] = size * course
            return change

        def again(after: Workspace) -> Candidate:
            last = space.transform.rows - ONSET_MARGIN
            near = range(max(row - ONSETS_EVERY, 1), min(row + ONSETS_EVERY + 1, last))
            return self.told(Scorer.of(over(space, after)), near)

        return Candidate(
            kind, struck, tuple(law.names[place] for place in struck),
            {**self.values, **{one.name: size * self.values[one.name] for one in kind.sizes}},
            evidence, onset=row, field=size * field, drives=drives, cost=worth - evidence,
            again=again,
        )  # fmt: skip


def kicking_pairs(law: PairLaw, mixing: Matrix, scorer: Scorer) -> Iterator[tuple[int, int]]:
    """Pairs and rows at which what comes at once shows, where any corrector seems to jump.

    Args:
        law: Of the pairs.
        mixing: Of every pair, shape (P, 2, 2).
        scorer: Of what is left to explain.
    """
    noise, transform = scorer.space.noise, scorer.space.transform
    along = scorer.rows.late @ law.patterns
    seen = law.patterns.T @ noise.modes
    weight = (seen * np.mean(1.0 / noise.variance(transform), axis=0)) @ seen.T
    clear = np.max(along**2 / np.maximum(np.diag(weight), 1e-300), axis=1)
    for step in np.argsort(-clear)[:_JUMPS]:
        if clear[step] < 2.0 * SURE:
            break
        row = int(transform.step_rows()[step])
        kicks = np.einsum("pkl,pl->pk", mixing, law.courses[row][law.pairs])
        pull = np.einsum("pk,pk->p", along[step][law.pairs], kicks)
        both = weight[law.pairs[:, :, None], law.pairs[:, None, :]]
        gain = any_size(pull, np.einsum("pk,pkl,pl->p", kicks, both, kicks))
        best = int(np.argmax(gain))
        if gain[best] > SURE:
            yield best, row

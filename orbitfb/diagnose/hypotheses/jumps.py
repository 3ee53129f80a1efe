"""Laws whose course is a constant: of them the row at which they begin is all that shows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import any_size
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import grown_apart
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw
from orbitfb.estimation.evidence import NormalTerms, best_size
from orbitfb.estimation.priors import SIZE_WIDTH, VALUE_COST
from orbitfb.estimation.transform import Indices, Matrix, StepTransform

_ROUNDING = 1e-6
"""Relative change of a course that is rounding [1]: a jump of 5 µm on an orbit of millimetres is
right to a hundredth of that."""


def jumps_of(law: DeviceLaw | FieldLaw, values: Values, scorer: Scorer) -> Matrix | None:
    """Change of the readings where a law begins, of every place, shape (n, D) [m].

    None of a law whose courses change within the record, and of one that does nothing.
    """
    courses = law.course(values, scorer.space.signals)
    parts = courses if isinstance(courses, tuple) else (courses,)
    constant = all(np.allclose(one, one[:1], rtol=_ROUNDING, atol=0.0) for one in parts)
    if not constant or not any(np.any(one) for one in parts):
        return None
    if isinstance(law, FieldLaw):
        return parts[0][:1].T
    return np.asarray(sum(one[0] * block for one, block in zip(parts, law.patterns, strict=True)))


def scan_jumps(
    kind: EffectKind,
    patterns: Matrix,
    names: tuple[str, ...],
    values: Values,
    scorer: Scorer,
    groups: Sequence[Indices] = (),
) -> list[Candidate]:
    """Find the place and the row of the most telling jump, and places that jump at one row.

    All BPMs of a crate jump when it is switched on again, each by an offset of its own, or all by
    the same where it is the reference of the crate that jumps.

    Args:
        kind: The effect.
        patterns: Change of the readings by a jump of the usual size, shape (n, D) [m].
        names: Of the places; none: the ring.
        values: Of its parameters, of the usual size.
        scorer: Of what is left to explain.
        groups: Places that may jump by the same.
    """
    pull, own = of_jumps(patterns, scorer)
    single = [(place,) for place in range(patterns.shape[1])]
    jump = _Jump(kind, patterns, names, values, 0)
    found = [jump.best(scorer, single, pull, own)]
    if groups:
        several = [tuple(map(int, group)) for group in groups]
        shapes = np.stack([np.sum(patterns[:, list(one)], axis=1) for one in several], axis=1)
        found.append(jump.best(scorer, several, *of_jumps(shapes, scorer)))
    if names:
        apart = _several(jump, pull, scorer)
        found += [] if apart is None else [apart]
    return found


def _several(jump: "_Jump", pull: Matrix, scorer: Scorer) -> Candidate | None:
    """Places that jump at one row, of what pulls at every step, (T, D); None: they are not more."""
    pull, information = _usually(jump.patterns, pull, scorer)
    gain = any_size(pull, np.broadcast_to(np.diag(information), pull.shape))
    step = int(np.argmax(np.sum(np.maximum(gain - np.log(len(jump.names)), 0.0), axis=1)))
    found = jump.found(pull[step], information)
    row = int(scorer.space.transform.step_rows()[step])
    return replace(jump, row=row).together(scorer, found) if len(found) > 1 else None


def _usually(patterns: Matrix, pull: Matrix, scorer: Scorer) -> tuple[Matrix, Matrix]:
    """Pull (T, D) and information (D, D) of jumps, as rows usually are, of what the floor says.

    A large step of a few BPMs is most of what the floor holds for their walk, so that it would tell
    little against it. What pulls at a place has the variance of its information if the floor is
    right; its median size tells how much less that usually is.
    """
    seen = patterns.T @ scorer.space.noise.modes
    information = (seen * _weight(scorer)) @ seen.T
    usual = (TO_SIGMA * np.median(np.abs(pull), axis=0)) ** 2
    more = np.maximum(np.diag(information) / np.maximum(usual, np.finfo(float).tiny), 1.0)
    return pull * more, np.sqrt(np.outer(more, more)) * information


@dataclass(frozen=True, slots=True, eq=False)
class _Jump:
    """Jumps at a row.

    Args:
        kind: The effect.
        patterns: Change of the readings by each of the usual size, shape (n, D) [m].
        names: Of the places; none: the ring.
        values: Of its parameters, of the usual size.
        row: At which they come.
    """

    kind: EffectKind
    patterns: Matrix
    names: tuple[str, ...]
    values: Values
    row: int

    def course(self, transform: StepTransform) -> Single:
        """Transformed steps of what jumps by one, shape (T, 1)."""
        late = (np.arange(transform.rows) >= self.row).astype(float)[:, None]
        return transform.quick_spectrum(late)

    def field(self, transform: StepTransform, places: Sequence[int], size: float) -> Matrix:
        """What places that jump by a size add to the readings, shape (T, n) [m]."""
        return size * self.course(transform) @ np.sum(self.patterns[:, places], axis=1)[None]

    def best(
        self, scorer: Scorer, sets: Sequence[tuple[int, ...]], pull: Matrix, information: Vector
    ) -> Candidate:
        """The most telling jump of all rows and sets of places, each by one size.

        Args:
            scorer: Of what is left to explain.
            sets: Of places, D of them.
            pull: Of every row and set, shape (T, D).
            information: Of the sets, shape (D,).
        """
        gain = any_size(pull, np.broadcast_to(information, pull.shape))
        step, number = map(int, np.unravel_index(int(np.argmax(gain)), gain.shape))
        row = int(scorer.space.transform.step_rows()[step])
        cost = float(np.log(gain.size)) + VALUE_COST
        return replace(self, row=row).sized(scorer, list(sets[number]), cost)

    def sized(self, scorer: Scorer, places: list[int], cost: float) -> Candidate:
        """Places that jump by one size, whatever is most likely."""
        transform = scorer.space.transform
        pulled, information = scorer.evaluate([self.field(transform, places, 1.0)])
        size = float(best_size(pulled, information[0], SIZE_WIDTH**2)[0])
        evidence = float(any_size(pulled, information[0])[0])
        return replace(
            self.one(transform, places, size, evidence - cost),
            again=lambda after: self.sized(Scorer.of(over(scorer.space, after)), places, cost),
        )

    def one(
        self, transform: StepTransform, places: list[int], size: float, evidence: float
    ) -> Candidate:
        """Places that jump by one size."""
        scaled = {**self.values, **{p.name: size * self.values[p.name] for p in self.kind.sizes}}
        where = tuple(places) if self.names else ()
        told = tuple(self.names[one] for one in where)
        field = self.field(transform, places, size)
        return Candidate(self.kind, where, told, scaled, evidence, onset=self.row, field=field)

    def together(self, scorer: Scorer, places: Indices) -> Candidate:
        """Several places that jump, each by a size of its own."""
        transform = scorer.space.transform
        course = np.repeat(self.course(transform), len(places), axis=1)
        terms = NormalTerms(
            *scorer.columns([self.patterns[:, places]], course),
            np.full(len(places), SIZE_WIDTH**2),
        )
        parts = tuple(
            self.one(transform, [int(place)], float(size), 0.0)
            for place, size in zip(places, terms.mean(), strict=True)
        )
        names = tuple(name for one in parts for name in one.names)
        field = np.sum([np.asarray(one.field) for one in parts], axis=0)
        cost = len(places) * np.log(len(self.names)) + np.log(transform.rows) + VALUE_COST
        cost = float(cost) + terms.cost(terms.mean())
        return Candidate(
            self.kind, tuple(map(int, places)), names, parts[0].values,
            scorer.likelihood(field) - cost, onset=self.row, field=field, parts=parts, cost=cost,
            again=lambda after: self.more(Scorer.of(over(scorer.space, after)), places),
        )  # fmt: skip

    def more(self, scorer: Scorer, places: Indices) -> Candidate:
        """The same, and whoever else jumps: over a floor that has none of it smaller ones show."""
        pull, information = _usually(self.patterns, scorer.rows.late @ self.patterns, scorer)
        step = int(np.searchsorted(scorer.space.transform.step_rows(), self.row))
        return self.together(scorer, np.union1d(places, self.found(pull[step], information)))

    def found(self, pull: Vector, information: Matrix) -> Indices:
        """Places that jump, from pull (D,) and information (D, D) of all at the row."""
        found, _ = grown_apart(pull, information, float(np.log(len(self.names))), True)
        return np.array(found, dtype=np.intp)


def of_jumps(patterns: Matrix, scorer: Scorer) -> tuple[Matrix, Vector]:
    """Pull (T, D) and information (D,) of a jump along each of D patterns at every step."""
    seen = patterns.T @ scorer.space.noise.modes
    return scorer.rows.late @ patterns, seen**2 @ _weight(scorer)


def _weight(scorer: Scorer) -> Vector:
    """Information of a step in every mode of the noise, shape (n,)."""
    return np.mean(1.0 / scorer.space.noise.variance(scorer.space.transform), axis=0)

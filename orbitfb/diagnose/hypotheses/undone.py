"""Readings that are undone: exchanged, or of the other sign, or bent so much that it counts.

What they do is as large as the orbit itself. A floor that was estimated with them takes most of it
for a wandering of these BPMs and expects it, so that a scan over that floor finds them hardly. So
each BPM is its own scale in every band: T frequencies whose mean square falls from v to v' when the
readings are undone are worth −T/2 ln(v'/v) [nats]. For those that change in the middle of a record
it is its own scale from step to step. A floor of their own will say about the same
(`own_floors.refitted`). Where a law takes a large part of the readings, its size is told so, too.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import within
from orbitfb.diagnose.hypotheses.refit import Course, climbed, highest
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, PairLaw, Signals
from orbitfb.estimation.priors import (
    FINENESS,
    MORE,
    ONSET_MARGIN,
    ONSETS_EVERY,
    SURE,
    VALUE_COST,
)
from orbitfb.estimation.transform import Indices, Matrix

_REACH = (0.25, 2.0)
"""Share of the size that follows in a straight line between which a bent one is sought [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class _Undone:
    """Choices of BPMs whose readings may be undone.

    Args:
        kind: The effect.
        law: Of it.
        columns: Of every choice, shape (P, k).
        back: What is taken off the readings of the columns, of these readings, shape (P, k, k).
    """

    kind: EffectKind
    law: DeviceLaw | PairLaw
    columns: Indices
    back: Matrix

    @classmethod
    def of(cls, kind: EffectKind, law: DeviceLaw | PairLaw, space: Workspace) -> "_Undone":
        """Lay out all choices of a law."""
        if isinstance(law, PairLaw):
            return cls(kind, law, law.pairs, law.mixing({}))
        (change,) = law.course({}, space.signals)
        readings = space.signals.record.readings
        part = np.sum(change * readings, axis=0) / np.maximum(np.sum(readings**2, axis=0), 1e-300)
        return cls(kind, law, np.arange(len(law.names))[:, None], part[:, None, None])

    def candidate(self, space: Workspace, number: int, gain: float, onset: int) -> Candidate:
        """One choice, undone from a row on.

        Args:
            space: Of the record.
            number: Of the choice.
            gain: What it is worth, but for the choice [nats].
            onset: The row; 0: it was always so.
        """
        chosen, back = self.columns[number], self.back[number]
        places = self.law.struck[number] if isinstance(self.law, PairLaw) else (number,)
        wider = float(np.linalg.slogdet(np.eye(len(chosen)) - back)[1])
        late = np.arange(space.transform.rows) >= onset

        def undo(its: Workspace) -> tuple[Matrix, float]:
            field = np.zeros_like(its.residual)
            read = its.signals.record.readings[:, chosen] @ back.T
            field[:, chosen] = its.transform.spectrum(np.where(late[:, None], read, 0.0))
            return field, wider * np.count_nonzero(late[its.transform.step_rows()])

        cost = float(np.log(len(self.columns))) + VALUE_COST
        if onset:
            cost += float(np.log(space.transform.rows))
        return Candidate(
            self.kind, places, tuple(self.law.names[place] for place in places), {}, gain - cost,
            onset=onset, field=undo(space)[0], cost=cost, undone=undo,
        )  # fmt: skip


def scan_undone(kind: EffectKind, law: DeviceLaw | PairLaw, scorer: Scorer) -> Iterator[Candidate]:
    """Find the BPM, or the pair, that follows the model best once its readings are undone.

    Args:
        kind: An effect without parameters.
        law: Of readings: of each BPM, or of pairs.
        scorer: Of what is left to explain.
    """
    space, its = scorer.space, _Undone.of(kind, law, scorer.space)
    if not len(its.columns):
        return
    read = space.transform.spectrum(space.signals.record.readings)
    gain = np.zeros(len(its.columns))
    for rows in scorer.members:
        own = np.sum(space.residual[rows] ** 2, axis=0)
        grown = _grown(space.residual[rows], read[rows], its)
        gain += _worth(own, grown, its.columns, len(rows))
    best = int(np.argmax(gain))
    yield its.candidate(space, best, float(gain[best]), 0)
    if kind.sudden:
        late = _late(its, space)
        if late is not None:
            yield late


def _late(its: _Undone, space: Workspace) -> Candidate | None:
    """The choice that is undone best from one row on; None: the record is too short."""
    left = space.transform.turn(space.residual)
    read = space.transform.steps(space.signals.record.readings)
    count, own = len(left), np.sum(left**2, axis=0)
    grown = np.zeros(its.columns.shape)
    best, number, first = -np.inf, 0, 0
    for begin in range((count - 1) // ONSETS_EVERY * ONSETS_EVERY, 0, -ONSETS_EVERY):
        rows = slice(begin, begin + ONSETS_EVERY)
        grown += _grown(left[rows], read[rows], its)
        if not ONSET_MARGIN <= begin <= count - ONSET_MARGIN:
            continue
        gain = _worth(own, grown, its.columns, count)
        if gain.max() > best:
            best, number, first = float(gain.max()), int(np.argmax(gain)), begin
    if not first:
        return None
    chosen = its.columns[number]
    change = space.signals.record.readings[:, chosen] @ its.back[number].T
    steps = space.transform.step_rows()
    found = []
    about = np.clip(
        first + np.array([-ONSETS_EVERY, ONSETS_EVERY]), ONSET_MARGIN, count - ONSET_MARGIN
    )
    for step in range(about[0], about[1] + 1):
        late = np.arange(len(change)) >= steps[step]
        less = space.transform.steps(np.where(late[:, None], change, 0.0))
        square = np.sum((left[:, chosen] - less) ** 2, axis=0)
        worth = -0.5 * count * np.log(np.maximum(square, 1e-300) / np.maximum(own[chosen], 1e-300))
        found.append((float(np.sum(worth)), int(steps[step])))
    gain, row = max(found)
    return its.candidate(space, number, gain, row)


def _grown(left: Matrix, read: Matrix, its: _Undone) -> Matrix:
    """By how much the square of every column grows if readings are undone, shape (P, k) [m²].

    Args:
        left: Steps, or their spectrum, of what the model leaves, shape (T, n) [m].
        read: Of the readings, shape (T, n) [m].
        its: The choices.
    """
    cross, square = left.T @ read, read.T @ read
    columns = its.columns
    found = np.empty(columns.shape)
    for place in range(columns.shape[1]):
        k, part = columns[:, place], its.back[:, place]
        found[:, place] = -2.0 * np.einsum("pl,pl->p", part, cross[k[:, None], columns])
        found[:, place] += np.einsum(
            "pl,plm,pm->p", part, square[columns[:, :, None], columns[:, None, :]], part
        )
    return found


def _worth(own: Vector, grown: Matrix, columns: Indices, count: int) -> Vector:
    """Nats by which each choice of columns follows the model better, shape (P,).

    Args:
        own: Square of every BPM as it is read, shape (n,) [m²].
        grown: By how much that of every column grows, shape (P, k) [m²].
        columns: Of every choice, shape (P, k).
        count: Of what the squares are the sum.
    """
    before = own[columns]
    after = np.maximum(before + grown, 1e-300)
    return -0.5 * count * np.sum(np.log(after / np.maximum(before, 1e-300)), axis=1)


def bent(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    source: Course,
    size: float,
    worth: float,
    field: Single,
) -> tuple[Course, float, float, Single]:
    """A BPM that is undone, if its readings bend with the size: it, size, log likelihood and field.

    A course is told of the orbit as it is read, in which the law is already: a curve that takes a
    quarter off a reading looks as if it took a third. Of a law of several sizes all are sought.

    Args:
        kind: The effect.
        law: Of BPMs, which is undone in their readings.
        scorer: Of what is left to explain.
        source: The BPM, with a size of one.
        size: That it has if what it reads follows the size.
        worth: Log likelihood of it over none.
        field: What it adds with it, shape (T, n) [m].
    """
    signals, transform, chosen = scorer.space.signals, scorer.space.transform, list(source.places)
    inside = ~signals.record.starts
    heard = replace(signals, record=replace(signals.record, readings=signals.orbit))
    own = (scorer.weights @ (scorer.modes[chosen] ** 2).T)[:, 0]
    left = scorer.beside_others(kind.target)[:, chosen[0]] / own

    def taken_off(its: Course, given: Signals) -> tuple[Matrix, float]:
        ((_, change, widened),) = its.undone(kind, given)
        return change, float(np.sum(widened[inside]))

    def density(rest: Vector) -> float:
        return -0.5 * len(rest) * float(np.log(np.mean(rest**2 * own)))

    def sized(size: float) -> Course:
        return replace(source, size=size * source.size)

    def undone(its: Course) -> float:
        change, widened = taken_off(its, signals)
        return widened + density(left - transform.quick_spectrum(change)[:, 0])

    if abs(undone(sized(size)) - density(left) - worth) < MORE:
        return source, size, worth, field
    share = highest(lambda share: undone(sized(share * size)), _REACH, FINENESS)
    best = within(kind, source.values, share * size)

    def told(its: Course) -> Single:
        found = np.zeros_like(field)
        found[:, chosen] = transform.quick_spectrum(taken_off(its, heard)[0])
        return found

    most = sized(best)
    if len(kind.sizes) > 1:
        most = _of_all_sizes(kind, most, scorer.space.courses.grid(kind), undone)
    short = max(undone(most) - undone(sized(best)), 0.0)
    if short > SURE:  # else one factor says nearly as much
        source, best, short = most, 1.0, 0.0
    # At least: beside errors that stand in for it, and by what the predicted orbit shows of it.
    least = undone(most) - density(scorer.pulled[:, chosen[0]] / own)
    return source, best, max(least, scorer.likelihood(told(most))) - short, told(sized(best))


def _of_all_sizes(
    kind: EffectKind, its: Course, grid: Sequence[Values], worth: Callable[[Course], float]
) -> Course:
    """A device whose sizes are each for itself where they explain most, near those of one factor.

    Args:
        kind: The effect.
        its: The device, with its sizes so far.
        grid: Values that are scanned, which say how large each size may be.
        worth: What sizes explain [nats].
    """
    now = {one.name: float(its.size[0]) * its.values[one.name] for one in kind.sizes}
    unit = {name: max(abs(values[name]) for values in grid) for name in now}
    plain = replace(its, size=np.ones_like(its.size))

    def at(shares: Vector) -> Course:
        sizes = {name: float(x) * unit[name] for name, x in zip(now, shares, strict=True)}
        return replace(plain, values={**its.values, **sizes})

    begin = np.array([now[name] / unit[name] for name in now])
    return at(climbed(lambda shares: worth(at(shares)), begin, 0.5 * float(np.max(np.abs(begin)))))

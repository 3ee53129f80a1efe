"""Readings that are undone without a choice of values: exchanged, or of the other sign.

What that does is as large as the orbit itself. A floor that was estimated with it takes most of it
for a wandering of these BPMs and expects it, so that a scan over that floor finds them hardly. So
each BPM is its own scale in every band: T frequencies whose mean square falls from v to v' when the
readings are undone are worth −T/2 ln(v'/v) [nats]. For those that change in the middle of a record
it is its own scale from step to step. A floor of their own will say about the same
(`own_floors.refitted`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, PairLaw
from orbitfb.estimation.priors import (
    ONSET_MARGIN,
    ONSETS_EVERY,
    VALUE_COST,
)
from orbitfb.estimation.transform import Indices, Matrix


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

"""Readings that are undone without a choice: exchanged, or of the other sign.

What they do is as large as the orbit itself. A floor that was estimated with them takes most of it
for a wandering of these BPMs and expects it, so that a scan over that floor finds them hardly. So
each BPM is its own scale in every band: T frequencies whose mean square falls from v to v' when the
readings are undone are worth −T/2 ln(v'/v) [nats]. A floor of their own will say about the same
(`run.refitted`).
"""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, PairLaw
from orbitfb.estimation.priors import VALUE_COST
from orbitfb.estimation.transform import Indices, Matrix


def scan_undone(kind: EffectKind, law: DeviceLaw | PairLaw, scorer: Scorer) -> list[Candidate]:
    """Find the BPM, or the pair, that follows the model best once its readings are undone.

    Args:
        kind: An effect without parameters.
        law: Of readings: of each BPM, or of pairs.
        scorer: Of what is left to explain.
    """
    space = scorer.space
    if isinstance(law, PairLaw):
        columns, back = law.pairs, law.mixing({})
    else:
        columns = np.arange(len(law.names))[:, None]
        (change,) = law.course({}, space.signals)
        readings = space.signals.record.readings
        part = np.sum(change * readings, axis=0) / np.maximum(np.sum(readings**2, axis=0), 1e-300)
        back = part[:, None, None]
    if not len(columns):
        return []
    read = space.transform.spectrum(space.signals.record.readings)
    gain = np.sum(
        [_gain(space.residual[rows], read[rows], columns, back) for rows in scorer.members], axis=0
    )
    best = int(np.argmax(gain))
    places = law.struck[best] if isinstance(law, PairLaw) else (best,)
    chosen = columns[best]
    wider = float(np.linalg.slogdet(np.eye(len(chosen)) - back[best])[1])

    def undo(its: Workspace) -> tuple[Matrix, float]:
        field = np.zeros_like(its.residual)
        read = its.signals.record.readings[:, chosen]
        field[:, chosen] = its.transform.spectrum(read @ back[best].T)
        return field, wider * len(its.transform)

    field, _ = undo(space)
    cost = float(np.log(len(columns))) + VALUE_COST
    names = tuple(law.names[place] for place in places)
    return [
        Candidate(
            kind, places, names, {}, float(gain[best]) - cost, field=field, cost=cost, undone=undo
        )
    ]  # fmt: skip


def _gain(left: Matrix, read: Matrix, columns: Indices, back: Matrix) -> Vector:
    """Nats by which each choice of columns follows the model better, shape (P,).

    Args:
        left: Spectrum of what the model leaves in a band, shape (T, n) [m].
        read: Of the readings, shape (T, n) [m].
        columns: Of every choice, shape (P, k).
        back: What is taken off the readings of the columns, of these readings, shape (P, k, k).
    """
    own, cross, square = left.T @ left, left.T @ read, read.T @ read
    found = np.zeros(len(columns))
    for place in range(columns.shape[1]):
        k = columns[:, place]
        part = back[:, place]
        before = own[k, k]
        after = before - 2.0 * np.einsum("pl,pl->p", part, cross[k[:, None], columns])
        after += np.einsum(
            "pl,plm,pm->p", part, square[columns[:, :, None], columns[:, None, :]], part
        )
        found -= 0.5 * len(left) * np.log(np.maximum(after, 1e-300) / np.maximum(before, 1e-300))
    return found

"""Errors of all devices, each of a size of its own: from a row on, or always."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.onsets.exact import kicks_of, standing
from orbitfb.diagnose.hypotheses.ranking import any_size
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.seen import semidefinite
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.priors import ONSETS_EVERY, SCATTERED, SURE
from orbitfb.estimation.transform import Indices, Matrix

_SEVERAL = 2.0
"""How many times as much all devices must show as the one that shows most [1]. By hand, for time:
what a single one does shows at its neighbours, too."""


def shown_together(gain: Matrix) -> Vector:
    """Log evidence that devices have together from each of several rows, shape (O,) of (O, D).

    Nothing where a single one may be enough, and where all are not enough for a cause.
    """
    beyond = np.maximum(gain - np.log(gain.shape[1]), 0.0)
    total = np.sum(beyond, axis=1)
    enough = np.maximum(_SEVERAL * np.max(beyond, axis=1), SURE)
    return np.where(total > enough, total, 0.0)


def every(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values, about: int, cost: float
) -> Candidate:
    """All devices of a law, with sizes around zero of any scatter, from a row on or always.

    Each device may jump at its row by whatever stands in it, unless its law knows what it has
    reached. They are told again over the floor that they leave, but for what remembers, which is
    told device by device with its states.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        values: Of the parameters.
        about: The row is sought near to this one; zero: it was always so.
        cost: Of the values [nats].
    """
    transform, devices = scorer.space.transform, len(law.names)
    row = _row(kind, law, scorer, values, about) if about else 0
    whole = Course(law, (), values, np.ones(devices), row)
    blocks = [number for number, one in enumerate(law.patterns) if np.any(one)]
    courses = whole.of(scorer.space.signals, values)
    spectra = [_wide(transform.quick_spectrum(courses[one]), devices) for one in blocks]
    own = [np.arange(devices)] * len(blocks)  # of what follows a device has one size in all planes
    if row and law.first is None:
        jump = transform.quick_spectrum((np.arange(transform.rows) >= row).astype(float)[:, None])
        kicks = scorer.space.courses.spectra(law, values)
        spectra += [jump * _wide(standing(kicks[one])[None], devices) for one in blocks]
        own += [devices * (1 + turn) + np.arange(devices) for turn in range(len(blocks))]
    patterns = [np.asarray(law.patterns[one]) for one in blocks] * (len(own) // len(blocks))
    sizes, lost = _sized(patterns, spectra, np.concatenate(own), devices, scorer)
    parts = zip(patterns, spectra, own, strict=True)
    field = np.sum([(one * sizes[which]) @ block.T for block, one, which in parts], axis=0)
    found = sizes[:devices]
    told = found * values[str(kind.linear)]
    usual = {**values, str(kind.linear): float(np.sqrt(np.mean(told**2)))}
    whole_cost = cost + lost + (float(np.log(transform.rows)) if row else 0.0)

    def again(after: Workspace) -> Candidate:
        return every(kind, law, Scorer.of(over(scorer.space, after)), values, row, cost)

    return Candidate(
        kind, (), (), usual, scorer.likelihood(field) - whole_cost, cost=whole_cost,
        onset=row, field=field, sizes=tuple(map(float, told)),
        sources=(Course(law, (), values, found, row),),
        again=None if kind.remembers else again,
    )  # fmt: skip


def _row(kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values, about: int) -> int:
    """The row near to another one from which all devices show most."""
    transform, devices = scorer.space.transform, len(law.names)
    rows = transform.step_rows()
    step = int(np.searchsorted(rows, about))
    near = np.arange(max(step - ONSETS_EVERY, 0), min(step + 2 * ONSETS_EVERY, len(rows)))
    error, spectra = scorer.own_error(kind), scorer.space.courses.spectra(law, values)
    parts = [
        scorer.rows.since(
            pattern, np.broadcast_to(transform.turn(one), (len(rows), devices)), near, error
        )
        for pattern, one in zip(law.patterns, spectra, strict=True)
    ]
    pull, information = (np.sum(its, axis=0) for its in zip(*parts, strict=True))
    gain = np.sum(np.maximum(any_size(pull, information), 0.0), axis=1)
    if law.first is None:
        gain += np.sum(np.maximum(kicks_of(law, scorer, spectra)[near], 0.0), axis=1)
    return int(rows[near[int(np.argmax(gain))]])


def _sized(
    patterns: Sequence[Matrix],
    spectra: Sequence[Single],
    own: Indices,
    devices: int,
    scorer: Scorer,
) -> tuple[Vector, float]:
    """Sizes of the most likely scatter, shape (k,), and what they cost [nats].

    Kicks at one row that need no law are not the law's.

    Args:
        patterns: Of every block of columns, (n, D) each [m].
        spectra: Transformed steps of their courses, (T, D) each.
        own: Which size a column has, of all blocks; those of the first D are the devices'.
        devices: D.
        scorer: Of what is left to explain.
    """
    pull, information = scorer.columns([np.hstack(patterns)], np.hstack(spectra))
    alike = np.equal.outer(np.arange(own.max() + 1), own).astype(float)
    pull, information = alike @ pull, semidefinite(alike @ information @ alike.T)

    def of(width: float) -> NormalTerms:
        variance = np.ones(len(pull))  # of kicks, in units of what may stand there
        variance[:devices] = width**2
        return NormalTerms(pull, information, variance)

    best = max(map(of, SCATTERED), key=lambda one: one.evidence())
    sizes = best.mean()
    kicks = of(0.0).evidence()
    needless = best.evidence() - kicks < SURE
    return sizes, best.cost(sizes) + (max(kicks, 0.0) if needless else 0.0)


def _wide(courses: Matrix | Single, devices: int) -> Single:
    """Courses of all devices, shape (T, D), where one may stand for all, (T, 1)."""
    return np.broadcast_to(courses, (len(courses), devices)).astype(np.float32)

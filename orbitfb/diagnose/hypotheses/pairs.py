"""Laws of two devices: exchanged, coupled, rolled."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import PairLaw
from orbitfb.estimation.evidence import given_size, normal_size
from orbitfb.estimation.priors import SIZE_WIDTH, VALUE_COST
from orbitfb.estimation.transform import Indices, Matrix


def scan_pairs(kind: EffectKind, law: PairLaw, scorer: Scorer) -> list[Candidate]:
    """Find the best pair of a law, from all products of patterns and courses at once."""
    if not len(law.pairs):
        return []
    space = scorer.space
    spectrum = space.transform.quick_spectrum(law.courses)
    pulls = ((scorer.pulled @ law.patterns).astype(np.float32).T @ spectrum).astype(np.float64)
    best: list[Candidate] = []
    for values in space.courses.grid(kind):
        mixing = law.mixing(values)
        pull, information = _pair_scores(law, scorer, spectrum, pulls, mixing)
        free = bool(kind.sizes)
        gain = (
            normal_size(pull, information, SIZE_WIDTH**2) if free else given_size(pull, information)
        )
        number = int(np.argmax(gain))
        best.append(_candidate(kind, law, scorer, number, values, mixing[number], free))
    return [max(best, key=lambda one: one.evidence)]


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


def _candidate(
    kind: EffectKind,
    law: PairLaw,
    scorer: Scorer,
    number: int,
    values: Values,
    mixing: Matrix,
    free: bool,
) -> Candidate:
    pair = law.pairs[number]
    courses = law.courses[:, pair] @ mixing.T
    field = scorer.space.transform.spectrum(courses) @ law.patterns[:, pair].T
    pull, information = scorer.evaluate([field])
    size = 1.0
    if free:
        gain = float(normal_size(pull, information[0], SIZE_WIDTH**2)[0])
        size = float(pull[0] / (information[0, 0] + SIZE_WIDTH**-2))
    else:
        gain = float(given_size(pull, information[0])[0])
    scaled = {**values, **{p.name: size * values[p.name] for p in kind.sizes}}
    struck = law.struck(number)
    cost = float(np.log(len(law.pairs))) + VALUE_COST * len(kind.parameters)
    names = tuple(law.names[place] for place in struck)
    back = law.mixing(scaled)[number]
    wider = float(np.linalg.slogdet(np.eye(2) - back)[1])

    def undo(space: Workspace) -> tuple[Matrix, float]:
        change = space.transform.spectrum(law.courses[:, pair] @ back.T)
        return change @ law.patterns[:, pair].T, wider * len(space.transform)

    return Candidate(
        kind, struck, names, scaled, gain - cost, field=size * field,
        undone=undo if law.readings else None,
    )  # fmt: skip

"""Laws whose course is a constant: of them the row at which they begin is all that shows."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import any_size
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw
from orbitfb.estimation.evidence import best_size
from orbitfb.estimation.priors import SIZE_WIDTH, VALUE_COST
from orbitfb.estimation.transform import Matrix

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
) -> list[Candidate]:
    """Find the place and the row of the most telling jump.

    Args:
        kind: The effect.
        patterns: Change of the readings by a jump of the usual size, shape (n, D) [m].
        names: Of the places; none: the ring.
        values: Of its parameters, of the usual size.
        scorer: Of what is left to explain.
    """
    space = scorer.space
    pull, own = of_jumps(patterns, scorer)
    gain = any_size(pull, np.broadcast_to(own, pull.shape))
    step, place = map(int, np.unravel_index(int(np.argmax(gain)), gain.shape))
    row = int(space.transform.step_rows()[step])
    jump = (np.arange(space.transform.rows) >= row).astype(float)[:, None]
    field = space.transform.spectrum(jump) @ patterns[:, place : place + 1].T
    pulled, information = scorer.evaluate([field])
    size = float(best_size(pulled, information[0], SIZE_WIDTH**2)[0])
    evidence = float(any_size(pulled, information[0])[0])
    evidence -= float(np.log(gain.size)) + VALUE_COST
    scaled = {**values, **{p.name: size * values[p.name] for p in kind.sizes}}
    where = (place,) if names else ()
    told = tuple(names[one] for one in where)
    return [Candidate(kind, where, told, scaled, evidence, onset=row, field=size * field)]


def of_jumps(patterns: Matrix, scorer: Scorer) -> tuple[Matrix, Vector]:
    """Pull (T, D) and information (D,) of a jump along each of D patterns at every step."""
    noise, transform = scorer.space.noise, scorer.space.transform
    weight = np.mean(1.0 / noise.variance(transform), axis=0)
    return scorer.rows.late @ patterns, ((patterns.T @ noise.modes) ** 2) @ weight

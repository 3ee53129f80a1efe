"""Laws of the whole ring: one orbit course, with values or with a size."""

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import FieldLaw
from orbitfb.estimation.evidence import given_size, normal_size
from orbitfb.estimation.priors import SIZE_WIDTH, VALUE_COST


def scan_field(kind: EffectKind, law: FieldLaw, scorer: Scorer) -> list[Candidate]:
    """Find the best values of a law of the ring."""
    space = scorer.space
    found = []
    for values in space.courses.grid(kind):
        field = space.courses.field(law, values)
        if not np.any(field):
            continue
        pull, information = scorer.evaluate([field])
        size = 1.0
        if kind.sizes:
            gain = float(normal_size(pull, information[0], SIZE_WIDTH**2)[0])
            size = float(pull[0] / (information[0, 0] + SIZE_WIDTH**-2))
        else:
            gain = float(given_size(pull, information[0])[0])
        scaled = {**values, **{p.name: size * values[p.name] for p in kind.sizes}}
        found.append(
            Candidate(
                kind, (), (), scaled, gain - VALUE_COST, field=size * field.astype(np.float64)
            )
        )
    return [max(found, key=lambda one: one.evidence)] if found else []

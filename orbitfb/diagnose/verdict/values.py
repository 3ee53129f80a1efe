"""Values of a cause's parameters with intervals."""

import numpy as np

from orbitfb.diagnose.answer_parts import ParameterValue
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.transform import Matrix

_NINETY = 1.645
"""Standard deviations of a normal number beyond which it is in one of ten cases, either side."""

_LEAST = 0.02
"""Least relative standard deviation of a value [1]: no law is right to better than that."""

_KNOWN_TO = 1.0
"""Relative standard deviation of a value before the record is seen [1]."""


def values_of(kind: EffectKind, part: Candidate, space: Workspace) -> dict[str, ParameterValue]:
    """Tell the values of a cause, those of the largest device where each has its own.

    Args:
        kind: The effect.
        part: The candidate.
        space: On which it was found.
    """
    spread = _relative(kind, part, space)
    found: dict[str, ParameterValue] = {}
    for parameter in kind.parameters:
        if parameter.name not in part.values:
            continue
        value = part.values[parameter.name]
        meaning = kind.meaning(parameter, value, space.signals.record)
        reach = _NINETY * abs(value) * spread.get(parameter.name, np.nan)
        known = np.isfinite(reach)
        found[parameter.name] = ParameterValue(
            value=value,
            low=max(value - reach, parameter.low) if known else None,
            high=min(value + reach, parameter.high) if known else None,
            unit=parameter.unit,
            meaning=meaning,
        )
    return found


def _relative(kind: EffectKind, part: Candidate, space: Workspace) -> dict[str, float]:
    """Relative standard deviations of the values that the record bears on, by parameter."""
    if not part.sources:
        return {}
    fields: dict[str, Matrix] = {}
    for name, patterns, courses in part.sources[0].columns(kind, space.signals):
        added = space.transform.spectrum(courses) @ patterns.T
        fields[name] = fields[name] + added if name in fields else added
    if not fields:
        return {}
    _, information = Scorer.of(space).evaluate(list(fields.values()))
    covariance = np.linalg.inv(information + np.eye(len(fields)) / _KNOWN_TO**2)
    spread = np.sqrt(np.maximum(np.diag(covariance), _LEAST**2))
    return dict(zip(fields, map(float, spread), strict=True))

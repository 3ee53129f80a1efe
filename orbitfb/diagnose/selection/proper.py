"""Laws that do in an extreme what another one does by nature, beside that other one."""

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.effects.laws import Signals
from orbitfb.estimation.priors import MISFIT, RIVAL


def proper(candidates: list[Candidate], signals: Signals) -> list[Candidate]:
    """Drop laws that do in an extreme only what a rival of theirs does by nature.

    A dead-band that no setpoint leaves is a corrector that is stuck. If no other law is a rival of
    the likeliest one, that one stays.

    Args:
        candidates: The likeliest first.
        signals: Of the record.
    """
    if not candidates:
        return candidates
    top = candidates[0].evidence
    least = top + float(np.log(RIVAL)) * (1.0 + MISFIT * max(top, 0.0))
    rivals = [one for one in candidates if one.evidence > least and one.sources]
    poor = [one for one in rivals if one.lacks(signals)]
    if len(poor) == len(rivals):
        return candidates
    return [one for one in candidates if one not in poor]

"""What may be the next cause where readings were not read, but drawn without it."""

from collections.abc import Sequence
from dataclasses import replace

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.corrected import drawn_apart, redrawn
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.priors import CLOSE, HEARD, LEADING, MISFIT, SURE


def leaders(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The best of every effect that leads, the best first."""
    found: dict[str, Candidate] = {}
    for one in candidates:
        if one.evidence > CLOSE * candidates[0].evidence:
            found.setdefault(one.kind.id, one)
    return list(found.values())[:LEADING]


def undecided(leading: Sequence[Candidate], space: Workspace) -> list[Candidate]:
    """Those that may be the next cause, if what was not read may say so; else none.

    It was drawn without any of them, and speaks against each by as much as that one moves it. No
    more does one gain that is weighed in readings drawn with it.

    Args:
        leading: The best of every effect that leads, the best first.
        space: That they were tried on.
    """
    apart = [0.0 if one.field is None else drawn_apart(space, one.field) for one in leading]
    best = leading[0].evidence
    if max(apart) <= SURE + MISFIT * best:
        return []
    whole = zip(leading, apart, strict=True)
    return [one for one, more in whole if one is leading[0] or one.evidence + more >= best]


def drawn_with(leading: Sequence[Candidate], space: Workspace) -> tuple[Candidate, Workspace]:
    """Draw what was not read with the next cause, whose values were told without.

    Readings that were drawn without a law speak against it, and for whatever follows them. So each
    effect that leads has readings drawn with it, and is weighed in those. It stays as it was found
    meanwhile: what was drawn without it would move it.

    Args:
        leading: The best of every effect that leads.
        space: That they were tried on.

    Returns:
        The one whose readings, read and drawn, are most likely, and the workspace with those.
    """
    found = []
    for one in leading:
        fresh, begin = space, space.trusting()
        for _ in range(HEARD):
            after = one.accepted(begin, spread=False)
            fresh = redrawn(fresh, after)
            begin = replace(fresh, noise=after.noise)
        whole = one.accepted(begin, spread=False).log_posterior() - (one.cost or 0.0)
        its = replace(one, evidence=whole - fresh.log_posterior())
        found.append((whole, its, fresh))
    return max(found, key=lambda one: one[0])[1:]

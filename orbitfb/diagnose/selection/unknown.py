"""Unknown laws, weighed as those of the library are: exactly, and over floors of their own."""

from collections.abc import Sequence, Set
from dataclasses import replace

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse, exactly, scan_free
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.weighed import Weighed
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.estimation.priors import FINALISTS, HEARD, LEADING, SURE, SWALLOWED


def unknown_laws(
    space: Workspace, best: Sequence[Candidate], deaf: Set[str], base: float | None
) -> list[FreeCourse]:
    """Weigh unknown laws, the most telling first.

    A scan leaves out what healthy errors of other devices hide, and the floor what it stands in
    for. A law of the library is weighed beside all errors and over a floor of its own; so is an
    unknown one that may be as good.

    Args:
        space: Over the best floor without any cause of the round.
        best: Of the library, if any.
        deaf: Devices that have no unknown law.
        base: Log posterior without any cause, where candidates were weighed over floors of their
            own; None: they were not.
    """
    scorer = Scorer.of(space)
    found = [one for one in scan_free(scorer) if deaf.isdisjoint(one.names)]
    rival = max((one.evidence for one in best), default=0.0)
    names = {name for one in best for name in one.names}
    hidden = SWALLOWED**2  # half may be in the errors, and half in the floor
    near = [one for one in found if one.places and one.evidence > max(rival, 0.0) / hidden]
    several = [*near[:LEADING], *(one for one in near[LEADING:] if set(one.names) == names)]
    # What all do alike was weighed so when it was scanned.
    told = [one if one.of_all else exactly(one, scorer)[0] for one in several]
    for of_all in (False, True):
        its = [one for one in told if one.of_all is of_all]
        leads = max(its, key=_telling, default=None)
        if leads is not None and base is not None and leads.evidence > rival / SWALLOWED:
            told[told.index(leads)] = _over_own_floor(leads, space, base)
    rest = [one for one in found if one not in several]
    return sorted([*told, *rest], key=_telling, reverse=True)[:FINALISTS]


def _telling(one: FreeCourse) -> float:
    return one.evidence


def _over_own_floor(one: FreeCourse, space: Workspace, base: float) -> FreeCourse:
    """Weigh an unknown law over a floor that is estimated with it.

    Args:
        one: Weighed beside all errors.
        space: Without it.
        base: Log posterior without any cause.
    """
    lower, best = space, one.evidence
    for _ in range(HEARD):
        _, field, cost = exactly(one, Weighed.of(lower))
        after = lower.explaining(field).with_floor()
        gain = after.log_posterior() - base - cost
        if gain < best + SURE:
            break
        lower, best = over(space, after), gain
    return replace(one, evidence=best)

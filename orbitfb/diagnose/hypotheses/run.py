"""The tournament: all hypotheses, the best accepted, and again."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.device_laws import scan_devices
from orbitfb.diagnose.hypotheses.each_own import scan_each_own
from orbitfb.diagnose.hypotheses.elements import scan_elements
from orbitfb.diagnose.hypotheses.events import scan_events
from orbitfb.diagnose.hypotheses.fields import scan_field
from orbitfb.diagnose.hypotheses.free_course import FreeCourse, scan_free
from orbitfb.diagnose.hypotheses.healthy import scan_errors
from orbitfb.diagnose.hypotheses.lines import scan_lines
from orbitfb.diagnose.hypotheses.onsets import jumps_of, scan_jumps, scan_late
from orbitfb.diagnose.hypotheses.pairs import scan_pairs
from orbitfb.diagnose.hypotheses.random_laws import scan_random
from orbitfb.diagnose.hypotheses.ranking import ranked
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.undone import scan_undone
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, ElementsLaw, EventLaw, FieldLaw, Law, PairLaw
from orbitfb.estimation.priors import (
    CLOSE,
    FINALISTS,
    HEARD,
    LEADING,
    MISFIT,
    ROUNDS,
    SETTLED,
    SURE,
)


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One round: every candidate, the best first, and the workspace that they were tried on.

    Args:
        space: Before anything of the round was accepted.
        candidates: Every one that was tried.
        free: Unknown laws of single devices, the most telling first.
    """

    space: Workspace
    candidates: tuple[Candidate, ...]
    free: tuple[FreeCourse, ...]


def tournament(
    space: Workspace,
    kinds: Sequence[EffectKind],
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[list[Candidate], list[Round]]:
    """Accept the best hypothesis while one is sure.

    Args:
        space: Of the record.
        kinds: Effects that the record can show.
        tell: Is told the effect that is tried, and what it takes.

    Returns:
        The accepted candidates in order, and all rounds, the last one without a sure candidate.
    """
    accepted: list[Candidate] = []
    rounds: list[Round] = []
    while True:
        told = {one.kind.id for one in accepted if one.noisy}
        left = [kind for kind in kinds if kind.id not in told]
        enough = SURE + MISFIT * sum(one.evidence for one in accepted)
        candidates = candidates_of(space, left, tell, enough)
        candidates = [one for one in candidates if not _echo(one, accepted)]
        candidates = _last_resort(refitted(candidates, space, enough), bool(accepted))
        deaf = _coloured(accepted)
        free = [one for one in scan_free(Scorer.of(space)) if one.name not in deaf][:FINALISTS]
        rounds.append(Round(space, tuple(_light(candidates)), tuple(free)))
        for one in candidates[:6]:
            tell("top " + one.describe())
        if len(accepted) == ROUNDS or not candidates or candidates[0].evidence < enough:
            return accepted, rounds
        if not accepted and free and free[0].evidence > candidates[0].evidence:
            return accepted, rounds  # nothing of the library is as good as a law without a name
        best, space = _settled(candidates[0], space.trusting())
        accepted.append(best)


def _settled(
    best: Candidate, space: Workspace, times: int = HEARD, spread: bool = True
) -> tuple[Candidate, Workspace]:
    """Accept a candidate, with the sizes that it has over the floor that it leaves.

    Args:
        best: The candidate.
        space: Without it.
        times: That its sizes are told anew, at most.
        spread: Whether its values may differ a little from device to device.
    """
    after = best.accepted(space, spread)
    for _ in range(times):
        if best.again is None or best.field is None:
            break
        last, more = best.field, best.again(after)
        best = replace(more, cost=best.cost if more.cost is None else more.cost)
        after = best.accepted(replace(space, noise=after.noise), spread)
        if np.linalg.norm(np.asarray(best.field) - last) < SETTLED * np.linalg.norm(last):
            break
    return best, after


def _echo(one: Candidate, accepted: Sequence[Candidate]) -> bool:
    """Whether it says again what is said of its BPMs.

    A BPM that averages, scales or delays does so to its noise as well, and what its law leaves
    wanders with the orbit: its noise, or what it reads, is not odd besides. And of a BPM whose
    noise is told to remember no law of its readings is: a feedback that acts on them makes the beam
    follow that noise, which looks like a law, and no floor has such a noise.
    """
    if one.kind.target != "bpm":
        return False
    if one.places and set(one.names) <= _coloured(accepted):
        return True
    if not (one.noisy or one.courseless):
        return False
    known = [set(its.places) for its in accepted if its.kind.target == "bpm" and not its.noisy]
    return any(not places or (one.places and set(one.places) <= places) for places in known)


def _coloured(accepted: Sequence[Candidate]) -> set[str]:
    """Names of single BPMs whose noise is told to remember."""
    return {name for one in accepted if one.coloured for name in one.names}


def _last_resort(candidates: list[Candidate], accepted: bool) -> list[Candidate]:
    """Tell that the noise of a BPM is unlike the others' only where nothing else is told.

    Whatever a BPM does that is in no law adds to its noise.
    """
    others = [one for one in candidates if not (one.noisy and one.courseless)]
    return others if accepted or (others and others[0].evidence >= SURE) else candidates


def _light(candidates: list[Candidate]) -> list[Candidate]:
    """Drop the fields of all but the finalists: each is as large as the record."""
    rest = [replace(one, field=None, finer=None) for one in candidates[FINALISTS:]]
    return [*candidates[:FINALISTS], *rest]


def candidates_of(
    space: Workspace,
    kinds: Sequence[EffectKind],
    tell: Callable[[str], None] = lambda text: None,
    enough: float = SURE,
) -> list[Candidate]:
    """Try every hypothesis on what is left, the best first; exactly where it may have enough."""
    scorer = Scorer.of(space)
    began = time.process_time()
    found = list(scan_errors(scorer))
    tell(f"errors {time.process_time() - began:.2f} s")
    for kind in kinds:
        began = time.process_time()
        for law in space.courses.laws(kind):
            found += _scan(kind, law, scorer)
        tell(f"{kind.id} {time.process_time() - began:.2f} s")
    return _refined(strongest(found), scorer, enough)


def _refined(candidates: list[Candidate], scorer: Scorer, enough: float) -> list[Candidate]:
    """Evaluate the finalists exactly, and refine their values, until all that lead are.

    A scan leaves out up to half of what is worth something, so less than half of what is enough,
    or a small part of the best, can win no more.
    """
    while True:
        top = candidates[0].evidence if candidates else 0.0
        least = max(0.5 * enough, CLOSE * top)
        for place in _leading(candidates):
            one = candidates[place]
            if one.finer is not None and one.evidence > least:
                fine = one.finer()
                better = one.field is None or fine.evidence > one.evidence
                candidates[place] = fine if better else replace(one, finer=None)
                break
        else:
            break
        candidates = strongest(candidates)
    for place in _leading(candidates):
        one = candidates[place]
        if one.field is not None and one.evidence > 0.0:
            cost = one.cost
            if cost is None:
                pull, information = scorer.evaluate([one.field])
                cost = float(pull[0] - 0.5 * information[0, 0]) - one.evidence
            gain = one.evidence + scorer.eased(one.field)
            candidates[place] = replace(one, evidence=gain, cost=cost)
    return strongest(candidates)


def _leading(candidates: list[Candidate]) -> list[int]:
    """Places of the finalists, and of the best of every effect: one has many sets and onsets."""
    first = {one.kind.id: place for place, one in reversed(list(enumerate(candidates)))}
    return sorted({*range(min(FINALISTS, len(candidates))), *first.values()})


def refitted(
    candidates: list[Candidate], space: Workspace, enough: float = SURE
) -> list[Candidate]:
    """Compare those that lead under floors that are estimated with each of them.

    A floor that was estimated without a cause stands in for what the cause does as far as it can,
    and so do the healthy errors: what a law is worth beside it depends on that. Under floors of
    their own a law and a random course, a reversed sign and a walk, are weighed alike.

    Args:
        candidates: The best first.
        space: That they were tried on.
        enough: Evidence from which one is accepted [nats]; half of it may be in the floor.

    Returns:
        The candidates, the best first.
    """
    if not candidates or candidates[0].evidence < 0.5 * enough or candidates[0].noisy:
        return candidates  # what is said of the noise alone is not weighed so
    space = space.saturable()
    # As often as with a cause: what a floor gains that was not at its best yet is of no cause.
    base = space.with_floor().log_posterior()
    found: list[Candidate] = []
    weighed: dict[tuple[str, bool], float] = {}
    for one in candidates:
        if one.noisy:
            found.append(one)
            continue
        # Each BPM is the scale of what is undone: beside the floor of all that counts for little.
        at_it = _beside(one, candidates[0]) and one.evidence > 0.5 * enough
        good = [gain for gain in weighed.values() if gain > 0.0]
        least = max(0.5 * enough, CLOSE * max(good, default=0.0))
        leads = at_it or one.evidence > (enough if one.undone else least)
        form = (one.kind.id, one.walk is None)  # a random course, or one that is told
        new = form not in weighed and (one.undone or len(good) < LEADING)
        if one.cost is not None and new and leads:
            one, after = _settled(one, space, times=1, spread=False)
            gain = after.log_posterior() - base - (one.cost or 0.0)
            weighed[form] = gain
        else:  # weighed over the floor of all: no more than its effect, or those that led, have
            gain = min(one.evidence, weighed.get(form, min(good, default=np.inf)))
        found.append(replace(one, evidence=gain))
    return strongest(found)


def _beside(one: Candidate, best: Candidate) -> bool:
    """Whether the best says of a device of it only that its course is odd.

    Whatever that device does is a random course to a floor that was estimated without it.
    """
    same = one.kind.target == best.kind.target
    return best.courseless and same and not set(one.places).isdisjoint(best.places)


def _scan(kind: EffectKind, law: Law, scorer: Scorer) -> list[Candidate]:
    """Scan a law by its form."""
    if not kind.parameters and (
        law.readings if isinstance(law, PairLaw) else isinstance(law, DeviceLaw) and law.undone
    ):
        return scan_undone(kind, law, scorer)
    if isinstance(law, DeviceLaw | FieldLaw):
        usual = {p.name: p.typical for p in kind.parameters}
        jumps = jumps_of(law, usual, scorer) if kind.sudden else None
        if jumps is not None:
            names = law.names if isinstance(law, DeviceLaw) else ()
            return scan_jumps(kind, jumps, names, usual, scorer)
    if isinstance(law, DeviceLaw):
        if law.periodic:
            return scan_lines(kind, law, scorer)
        rank = ranked(kind, law, scorer)
        return [
            *scan_devices(kind, law, scorer, rank),
            *scan_late(kind, law, scorer, rank),
            *scan_each_own(kind, law, scorer, rank),
        ]
    if isinstance(law, PairLaw):
        return scan_pairs(kind, law, scorer)
    if isinstance(law, FieldLaw):
        return scan_field(kind, law, scorer)
    if isinstance(law, ElementsLaw):
        return scan_elements(kind, law, scorer)
    if isinstance(law, EventLaw):
        return scan_events(kind, law, scorer)
    return scan_random(kind, law, scorer)

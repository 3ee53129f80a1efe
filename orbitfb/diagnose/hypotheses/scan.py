"""All hypotheses on what is left of a record, the best first."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate, strongest
from orbitfb.diagnose.hypotheses.device_laws import scan_devices
from orbitfb.diagnose.hypotheses.each_own import scan_each_own
from orbitfb.diagnose.hypotheses.elements import scan_elements
from orbitfb.diagnose.hypotheses.events import scan_events
from orbitfb.diagnose.hypotheses.healthy import scan_errors
from orbitfb.diagnose.hypotheses.jumps import jumps_of, scan_jumps
from orbitfb.diagnose.hypotheses.lines import scan_lines
from orbitfb.diagnose.hypotheses.onsets.scan import scan_late
from orbitfb.diagnose.hypotheses.pairs import scan_pairs
from orbitfb.diagnose.hypotheses.random_laws import scan_random
from orbitfb.diagnose.hypotheses.ranking import ranked
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.undone.scan import scan_undone
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw, ElementsLaw, EventLaw, FieldLaw, Law, PairLaw
from orbitfb.estimation.evidence import given_size, normal_size
from orbitfb.estimation.priors import CLOSE, FINALISTS, SIZE_WIDTH, SURE, SWALLOWED, VALUE_COST


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

    A scan leaves out up to half of what is worth something, and the floor has up to half, so less
    than a quarter of what is enough, or a small part of the best, can win no more. A scan leaves
    out more of a law that begins late, whose beginning the floor has for a walk. That the noise of
    a BPM is odd wins against none.
    """
    hidden = enough / SWALLOWED**2
    while True:
        told = (one.evidence for one in candidates if not (one.noisy and one.courseless))
        top = next(told, 0.0)
        for place in _leading(candidates):
            one = candidates[place]
            least = hidden if one.onset else max(hidden, CLOSE * top)
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
                cost = scorer.likelihood(one.field) - one.evidence
            gain = one.evidence + scorer.eased(one.field)
            candidates[place] = replace(one, evidence=gain, cost=cost)
    return strongest(candidates)


def _leading(candidates: list[Candidate]) -> list[int]:
    """Places of the finalists, and of the best of every effect, late or not: one has many sets."""
    first = {
        (one.kind.id, one.onset > 0): place for place, one in reversed(list(enumerate(candidates)))
    }
    return sorted({*range(min(FINALISTS, len(candidates))), *first.values()})


def _scan(kind: EffectKind, law: Law, scorer: Scorer) -> list[Candidate]:
    """Scan a law by its form."""
    if (
        not kind.parameters
        and isinstance(law, DeviceLaw | PairLaw)
        and (law.readings if isinstance(law, PairLaw) else law.undone)
    ):
        return list(scan_undone(kind, law, scorer))
    if isinstance(law, DeviceLaw | FieldLaw):
        usual = {p.name: p.typical for p in kind.parameters}
        jumps = jumps_of(law, usual, scorer) if kind.sudden else None
        if jumps is not None:
            if isinstance(law, FieldLaw):
                return scan_jumps(kind, jumps, (), usual, scorer)
            groups = tuple(law.groups.values())
            return scan_jumps(kind, jumps, law.names, usual, scorer, groups)
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
        return _scan_field(kind, law, scorer)
    if isinstance(law, ElementsLaw):
        return scan_elements(kind, law, scorer)
    if isinstance(law, EventLaw):
        return scan_events(kind, law, scorer)
    return scan_random(kind, law, scorer)


def _scan_field(kind: EffectKind, law: FieldLaw, scorer: Scorer) -> list[Candidate]:
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

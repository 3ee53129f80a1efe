"""Diagnose a record: gap, where, which effect, how far it shrinks, what to do."""

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.answer import Diagnosis
from orbitfb.diagnose.answer_parts import Finding as Told
from orbitfb.diagnose.answer_parts import NotTested, Provenance
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import SEARCH_SECONDS, Budget
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.certain import beside, certain_causes, shown_by
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.finding import Finding
from orbitfb.diagnose.judgement import judge
from orbitfb.diagnose.naming import as_in_record
from orbitfb.diagnose.parts import Parts
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.provenance import versions
from orbitfb.diagnose.rounds import CLOSE, LIKELY, SURE
from orbitfb.diagnose.search import Outcome, search
from orbitfb.diagnose.shrink import put_aside
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.records.record import Record

_SCREENED = ("bpm-stuck", "missed-read")
"""Effects that leave exact repeats: the integrity screen is certain of them, or they are not."""


def diagnose(
    record: Record,
    reference: Record | None,
    holdout: Record | None,
    *,
    seed: int,
    without: frozenset[str] = frozenset(),
    findings: Sequence[Finding] = (),
    search_seconds: float = SEARCH_SECONDS,
    progress: Progress,
) -> Diagnosis:
    """Answer where the gap of a record lies and what causes it.

    Args:
        record: In question.
        reference: Of a time without a gap: it tells the floor of the noise.
        holdout: Later than the record: it tells how far the gap shrinks.
        seed: Of the bootstrap.
        without: Ids of effects that are not to be considered.
        findings: Of the integrity screen; those that prove an effect are causes.
        search_seconds: Processor time after which the search gives what it has [s].
        progress: Is told what is being done, and which share of all.
    """
    began = time.monotonic()
    certain = certain_causes(record, findings, without)
    kinds, not_tested = _able(certain.record, without)
    whole = certain.record
    floor = None if reference is None else Bench(beside(reference, whole)).floor
    first, later = put_aside(whole) if holdout is None else (whole, beside(holdout, whole))
    given = certain.given
    budget = Budget(search_seconds)
    shown = shown_by(findings, whole)

    def look(
        part: Record,
        begin: float,
        end: float,
        *also: Candidate,
        only: frozenset[str] = frozenset(all_effects()),
    ) -> Outcome:
        own = [kind for kind in kinds if kind.id in only]

        def tell(what: str, share: float) -> None:
            progress(what, begin + share * (end - begin))

        besides = bool(certain.causes)
        return search(
            part, own, floor, given, tell, budget, shown,
            beside=besides, also=also, others=len(kinds) - len(own),
        )  # fmt: skip

    outcome = look(first, 0.0, 0.7)
    if certain.given and not budget.over():
        # The screen judges channels by few rows: what it proves must also explain the record best.
        free = search(first, kinds, floor, (), budget=budget, shown=shown)
        better = free.bench.full_log_likelihood > outcome.bench.full_log_likelihood
        if better or _taken_back(given, outcome):
            certain, outcome = certain.without_given(), free
    given = certain.given
    if not outcome.sure and first is not whole and not budget.over():
        # Nothing sure yet: the end of the record may show what its beginning does not. All of it is
        # looked at in full only if what has a chance is there.
        hopeful, late = outcome.hopeful, list[Candidate]()
        if not given:
            end = look(_end(whole, first), 0.7, 0.75)
            hopeful |= end.hopeful
            late = end.late(_end_row(whole, first), len(whole))
        there = bool(given) or (
            bool(hopeful) and bool(look(whole, 0.75, 0.8, *late, only=hopeful).winners)
        )
        again = look(whole, 0.8, 0.85, *late) if there else outcome
        if again.sure or (not outcome.winners and (again.winners or not given)):
            outcome, later = again, None
    lacking = () if holdout is None else _lacking(outcome, holdout)
    if lacking:
        later = None
    judged = judge(outcome, certain, seed)
    progress("taking the gap apart", 0.85)
    parts = Parts(outcome, judged, later, holdout is not None, kinds, seed)
    answer = parts.answer(certain, (*not_tested, *_unseen(budget)))
    return answer.model_copy(
        update={
            "causes": as_in_record(answer.causes, record.layout),
            "findings": (*answer.findings, *_cut(outcome), *_untold(lacking)),
            "provenance": _provenance(
                record, reference, holdout, outcome, seed, time.monotonic() - began
            ),
        }
    )


def _end(whole: Record, first: Record) -> Record:
    """As many of the first rows as there are others, and these: what began late shows there."""
    end = whole.rows(_end_row(whole, first), len(whole))
    return replace(end, time=end.time - end.time[0])  # what grows begins with its first row


def _end_row(whole: Record, first: Record) -> int:
    return max(2 * len(first) - len(whole), 0)


def _taken_back(given: Sequence[Cause], outcome: Outcome) -> bool:
    """Whether a search undid what was given: a sign turned twice is none."""
    known = {(cause.kind.id, cause.places) for cause in given}
    found = [one.accepted for one in outcome.winners if one.accepted is not None]
    return any((entry.kind.id, entry.cause.places) in known for entry in found)


def _able(
    record: Record, without: frozenset[str]
) -> tuple[list[EffectKind], tuple[NotTested, ...]]:
    """Split the kinds into those that the record can show and those that it cannot."""
    able: list[EffectKind] = []
    unable: list[NotTested] = []
    for kind in all_effects().values():
        reason = "left out on request" if kind.id in without else kind.unavailable(record)
        if reason and kind.id not in _SCREENED:
            unable.append(NotTested(effect=kind.id, reason=reason))
        elif kind.id not in _SCREENED:
            able.append(kind)
    return able, tuple(unable)


def _unseen(budget: Budget) -> Iterator[NotTested]:
    """Effects that there was no time for."""
    reason = f"the search was cut short after {budget.seconds:.0f} s of processor time"
    for name in budget.unseen:
        yield NotTested(effect=name, reason=reason)


def _lacking(outcome: Outcome, later: Record) -> tuple[str, ...]:
    """Channels that causes follow and a later record does not have."""
    record = outcome.bench.record
    needed = (name for its in outcome.causes for name in its.kind.follows(its.values, record))
    return tuple(dict.fromkeys(name for name in needed if name not in later.auxiliary))


def _untold(lacking: Sequence[str]) -> Iterator[Told]:
    """Say that a later record cannot tell how far the gap shrinks."""
    if lacking:
        text = (
            f"the later record has no channel {', '.join(lacking)}, which a cause follows: how far "
            "the gap shrinks there is not told"
        )
        yield Told(check="later-channel", severity="warning", text=text)


def _cut(outcome: Outcome) -> Iterator[Told]:
    """What else there was no time for."""
    if outcome.cut:
        yield Told(check="search-time", severity="warning", text=outcome.cut)


def _provenance(
    record: Record,
    reference: Record | None,
    holdout: Record | None,
    outcome: Outcome,
    seed: int,
    seconds: float,
) -> Provenance:
    floor = outcome.bench.floor
    steps = float(np.sqrt(floor.mean_square(floor.walk)))
    model = np.ascontiguousarray(record.layout.response)
    return Provenance(
        data_sha256=record.digest,
        seed=seed,
        versions=versions(),
        source=record.source,
        reference_sha256="" if reference is None else reference.digest,
        reference_source="" if reference is None else reference.source,
        holdout_sha256="" if holdout is None else holdout.digest,
        holdout_source="" if holdout is None else holdout.source,
        model_sha256=hashlib.sha256(model.tobytes()).hexdigest(),
        library_sha256=hashlib.sha256("\n".join(all_effects()).encode()).hexdigest(),
        ticks=len(record),
        bpms=len(record.layout.bpms),
        correctors=len(record.layout.correctors),
        planes="".join(record.layout.planes),
        period_s=record.layout.period,
        reading_noise_um=1e6 * float(np.sqrt(np.mean(floor.readings))),
        drift_um_per_tick=1e6 * steps,
        gauge="the healthy scatter of all gains, with mean zero",
        thresholds={"probability": SURE, "likely": LIKELY, "rivals_nats": CLOSE},
        seconds=seconds,
    )

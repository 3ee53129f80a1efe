"""Diagnose a record: gap, where, which effect, how far it shrinks."""

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.diagnose.experiments.search import experiment_for
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.audit import audit
from orbitfb.diagnose.impact.closed_loop import closed_loop
from orbitfb.diagnose.impact.detectable import detectable
from orbitfb.diagnose.impact.explained import Explained
from orbitfb.diagnose.impact.gap import Parts, gap
from orbitfb.diagnose.impact.named import Named, named
from orbitfb.diagnose.impact.one_step import OneStep, k_steps
from orbitfb.diagnose.impact.score_map import score_map
from orbitfb.diagnose.impact.slices import fingerprints, lag_profile, likeness
from orbitfb.diagnose.impact.windows import Windows
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.provenance import versions
from orbitfb.diagnose.result.blocks import ScoreMap
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.headline import headline
from orbitfb.diagnose.result.naming import as_in_record, geometry
from orbitfb.diagnose.result.parts import Cause, Experiment, NotTested, Provenance
from orbitfb.diagnose.selection.search import search
from orbitfb.diagnose.verdict.causes import (
    ambiguous_sets,
    cause_of,
    struck_by,
    tournament_of,
    waterfall_of,
)
from orbitfb.diagnose.verdict.proved import SCREENED, beside, proved
from orbitfb.diagnose.verdict.shrink import Records, shrunk_by, shrunk_here
from orbitfb.diagnose.verdict.state import (
    beside_each_other,
    beside_left,
    beside_proved,
    judged,
)
from orbitfb.diagnose.verdict.unknown import unknown_of
from orbitfb.diagnose.verdict.values import Measured
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.estimation.priors import SURE
from orbitfb.records.finding import Finding
from orbitfb.records.record import Record

_ONE_COURSE = 1e-12
"""Second largest variance of the readings' modes, of the largest, below which they are one course
[1]: rounding leaves that."""

_SEARCHED = 0.85
"""Share of the whole work that the tournament is [1], for the progress that is told."""


def diagnose(
    record: Record,
    reference: Record | None = None,
    holdout: Record | None = None,
    *,
    seed: int,
    without: frozenset[str] = frozenset(),
    findings: Sequence[Finding] = (),
    progress: Progress,
) -> Diagnosis:
    """Answer where the gap of a record lies and what causes it.

    Args:
        record: In question.
        reference: Of a time without a gap: it tells the floor of the noise.
        holdout: Later than the record: it tells how far the gap shrinks.
        seed: Of the draws that intervals come from.
        without: Ids of effects that are not to be considered.
        findings: Of the integrity screen; those that prove an effect are causes.
        progress: Is told what is being done, and which share of all.

    Raises:
        EstimationError: The record is too short, or does not move.
    """
    began = time.monotonic()
    certain = proved(record, findings, without)
    _check(certain.record)
    kinds, not_tested = _able(certain.record, without)
    progress("estimating the floor", 0.0)
    healthy = None
    if reference is not None:
        healthy = Workspace.of(beside(reference, certain.record), kinds)
    space = Workspace.of(certain.record, kinds, reference=healthy)
    tell = _Telling(progress, len(kinds))
    accepted, rounds = search(space, kinds, tell)
    progress("taking the gap apart", _SEARCHED)
    found = named(accepted, rounds)
    verdict = judged(found, rounds)
    causes = [] if verdict.state == "unknown" else found
    its = Explained.of(causes, accepted, rounds)
    windows = Windows.of(len(its.space.transform), seed)
    step = OneStep.of(its, windows, None if healthy is None else healthy.noise)
    parts = Parts.of(its, causes, verdict.nats, windows)
    the_gap = gap(its, parts, causes, step.above, step.floor)
    last = Scorer.of(its.space)
    first = Scorer.of(rounds[0].space) if len(rounds) > 1 else last
    scores = score_map(causes, rounds[0], first)
    own = shrunk_here(its, step, parts)
    verdict = beside_left(verdict, own, its.foretold)
    verdict = beside_each_other(verdict, [struck_by(one, its.space) for one in causes])
    told = (*certain.causes, *_told(causes, its, last, scores, verdict.explained))
    shrunk, warnings = shrunk_by(
        Records(certain.record, reference, holdout), kinds, its, causes, step, parts, own,
        None if healthy is None else healthy.noise,
    )  # fmt: skip
    loop = closed_loop(its, causes, windows) if causes else None
    state = beside_proved(verdict.state, certain)
    sets = ambiguous_sets(causes) if state == "ambiguous" else ()
    unknown = unknown_of(verdict, found, certain.untold)
    told = as_in_record(told, record.layout)
    return Diagnosis(
        state=state,
        headline=headline(
            state, gap=the_gap, causes=told, shrink=shrunk, closed_loop=loop, ambiguous=sets,
            unknown=unknown, effects=len(kinds),
        ),
        causes=told,
        gap=the_gap,
        shrink=shrunk,
        experiment=_experiment(causes, seed),
        not_tested=not_tested,
        detectable=detectable(kinds, last),
        findings=warnings,
        ambiguous=sets,
        unknown=unknown,
        k_steps=k_steps(its, step) if causes and its.counts else (),
        closed_loop=loop,
        tournament=tournament_of(kinds, rounds, accepted),
        waterfall=waterfall_of(causes, parts.by_cause.tolist(), parts.whole, step_count(its))
        if causes else (),
        audit=audit(its, windows),
        fingerprints=fingerprints(its, causes),
        score_map=scores,
        lag_profile=lag_profile(its),
        identifiability=likeness(rounds[0].candidates, first),
        geometry=geometry(certain.record.layout),
        provenance=_provenance(
            Records(record, reference, holdout), its, seed, time.monotonic() - began
        ),
    )  # fmt: skip


def _check(record: Record) -> None:
    """Refuse readings that are all one course: noise and motion cannot be told apart.

    Raises:
        EstimationError: They are.
    """
    moving = record.readings - record.readings.mean(axis=0)
    spectrum = np.linalg.eigvalsh(moving.T @ moving)
    if len(spectrum) > 1 and spectrum[-1] > 0.0 and spectrum[-2] < _ONE_COURSE * spectrum[-1]:
        raise EstimationError(
            "all BPMs read the same course, each times a factor, so noise of single BPMs cannot "
            "be told from motion; give the readings themselves, not a fitted orbit"
        )


def _told(
    causes: Sequence[Named],
    its: Explained,
    scorer: Scorer,
    scores: ScoreMap | None,
    explained: float,
) -> Iterator[Cause]:
    """The causes with their values."""
    measured = Measured(scorer)
    for one, parts in zip(causes, its.pieces, strict=True):
        yield cause_of(one, parts, measured, scores, explained)


def step_count(its: Explained) -> int:
    """Steps from row to row."""
    return len(its.space.transform)


@dataclass(slots=True)
class _Telling:
    """Turns what a tournament tells of its effects into a share of the work."""

    progress: Progress
    effects: int
    done: int = 0

    def __call__(self, text: str) -> None:
        name = text.split(" ")[0]
        if name in all_effects():
            self.done += 1
            # Every round is half of what is left: nobody knows how many there are.
            rounds, within = divmod(self.done, max(self.effects, 1))
            share = 1.0 - 0.5 ** (rounds + within / max(self.effects, 1))
            self.progress(f"testing {all_effects()[name].title}", _SEARCHED * share)


def _able(
    record: Record, without: frozenset[str]
) -> tuple[list[EffectKind], tuple[NotTested, ...]]:
    """Split the kinds into those that the record can show and those that it cannot."""
    able: list[EffectKind] = []
    unable: list[NotTested] = []
    for kind in all_effects().values():
        reason = "left out on request" if kind.id in without else kind.unavailable(record)
        if kind.id in SCREENED and kind.id not in without:
            continue
        if reason:
            unable.append(NotTested(effect=kind.id, reason=reason))
        else:
            able.append(kind)
    return able, tuple(unable)


def _experiment(causes: Sequence[Named], seed: int) -> Experiment | None:
    """What would tell the first cause that has rivals from them."""
    open_one = next((one for one in causes if one.rivals), None)
    if open_one is None:
        return None
    best = {one.kind.id: one for one in reversed(open_one.round.candidates)}
    rivals = [best[name] for name in open_one.rivals]
    return experiment_for(open_one.round.space, open_one.parts[0], rivals, seed)


def _provenance(records: Records, its: Explained, seed: int, seconds: float) -> Provenance:
    record, reference, later = records.record, records.reference, records.later
    model = np.ascontiguousarray(record.layout.response)
    noise = its.noise
    return Provenance(
        data_sha256=record.digest,
        seed=seed,
        versions=versions(),
        source=record.source,
        reference_sha256="" if reference is None else reference.digest,
        reference_source="" if reference is None else reference.source,
        holdout_sha256="" if later is None else later.digest,
        holdout_source="" if later is None else later.source,
        model_sha256=hashlib.sha256(model.tobytes()).hexdigest(),
        library_sha256=hashlib.sha256("\n".join(all_effects()).encode()).hexdigest(),
        ticks=len(record),
        bpms=len(record.layout.bpms),
        correctors=len(record.layout.correctors),
        planes="".join(record.layout.planes),
        period_s=record.layout.period,
        reading_noise_um=1e6 * float(np.sqrt(np.mean(noise.reading))),
        drift_um_per_tick=1e6 * float(np.sqrt(np.mean(np.diag(noise.walk)))),
        gauge="the healthy scatter of all gains, with mean zero",
        thresholds={"sure_nats": SURE},
        seconds=seconds,
    )

"""Diagnose a record: gap, where, which effect, how far it shrinks, what to do."""

import time
from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.answer import Diagnosis, State
from orbitfb.diagnose.answer_blocks import Unknown
from orbitfb.diagnose.answer_parts import NotTested, Provenance
from orbitfb.diagnose.answering import named_causes, tournament_rows
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.certain import Certain, certain_causes
from orbitfb.diagnose.finding import Finding
from orbitfb.diagnose.gap import gap
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.diagnose.naming import geometry
from orbitfb.diagnose.search import Outcome, Progress, search
from orbitfb.diagnose.wording import headline
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.record import Record
from orbitfb.effects.registry import all_effects

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
        progress: Is told what is being done, and which share of all.
    """
    began = time.monotonic()
    certain = certain_causes(record, findings, without)
    kinds, not_tested = _able(certain.record, without)
    floor = None if reference is None else Bench(reference).floor
    outcome = search(
        certain.record, kinds, floor, certain.given, lambda what, s: progress(what, 0.8 * s)
    )
    progress("taking the gap apart", 0.8)
    return _assembled(certain, outcome, floor, holdout, not_tested, seed, began)


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


def _assembled(
    certain: Certain,
    outcome: Outcome,
    floor: NoiseFloor | None,
    holdout: Record | None,
    not_tested: tuple[NotTested, ...],
    seed: int,
    began: float,
) -> Diagnosis:
    record = certain.record
    causes = (*certain.causes, *named_causes(outcome))
    stage_gains: dict[str, float] = {}
    for one in outcome.rounds[:1]:
        for entry in one.entries:
            stage = entry.kind.stage
            stage_gains[stage] = max(stage_gains.get(stage, 0.0), entry.candidate.gain)
    the_gap = gap(outcome.bench, stage_gains=stage_gains, seed=seed)
    state: State = "named" if causes else "no_gap"
    unknown: Unknown | None = None
    return Diagnosis(
        state=state,
        headline=headline(state, gap=the_gap, causes=causes, unknown=unknown),
        causes=causes,
        gap=the_gap,
        not_tested=not_tested,
        tournament=tournament_rows(outcome),
        geometry=geometry(record.layout),
        unknown=unknown,
        provenance=Provenance(
            data_sha256=record.digest,
            seed=seed,
            versions={},
            source=record.source,
            ticks=len(record),
            bpms=len(record.layout.bpms),
            correctors=len(record.layout.correctors),
            planes="".join(record.layout.planes),
            period_s=record.layout.period,
            reading_noise_um=1e6 * float(np.sqrt(outcome.bench.floor.reading)),
            seconds=time.monotonic() - began,
        ),
    )

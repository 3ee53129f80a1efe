"""Diagnose a record by the tournament of all hypotheses."""

import hashlib
import time
from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.answer import Diagnosis, State
from orbitfb.diagnose.answer_blocks import AmbiguousSet, Tournament, TournamentRow, Unknown
from orbitfb.diagnose.answer_parts import Cause, NotTested, Provenance
from orbitfb.diagnose.certain import certain_causes
from orbitfb.diagnose.finding import Finding
from orbitfb.diagnose.hypotheses.priors import SURE
from orbitfb.diagnose.hypotheses.run import Round, tournament
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.naming import as_in_record, devices_and_planes, geometry
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.provenance import versions
from orbitfb.diagnose.verdict.impact import OneStep, gap, shrink
from orbitfb.diagnose.verdict.named import Named, named, probabilities
from orbitfb.diagnose.verdict.state import Judged, judged
from orbitfb.diagnose.verdict.values import values_of
from orbitfb.diagnose.wording import headline
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.registry import all_effects
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_SCREENED = ("bpm-stuck", "missed-read")
"""Effects that leave exact repeats: the integrity screen is certain of them, or they are not."""


def diagnose(
    record: Record,
    *,
    seed: int,
    without: frozenset[str] = frozenset(),
    findings: Sequence[Finding] = (),
    progress: Progress,
) -> Diagnosis:
    """Answer where the gap of a record lies and what causes it.

    Args:
        record: In question.
        seed: Told in the answer.
        without: Ids of effects that are not to be considered.
        findings: Of the integrity screen; those that prove an effect are causes.
        progress: Is told what is being done, and which share of all.
    """
    began = time.monotonic()
    certain = certain_causes(record, findings, without).without_given()
    kinds, not_tested = _able(certain.record, without)
    progress("estimating the floor", 0.0)
    space = Workspace.of(certain.record, kinds)
    accepted, rounds = tournament(space, kinds, lambda text: progress(text, 0.5))
    causes = named(accepted, rounds)
    verdict = judged(causes, rounds)
    final = rounds[-1].space
    step = OneStep.of(final)
    told = (*certain.causes, *(_cause(one, final) for one in causes))
    if verdict.state == "unknown":
        told = certain.causes
    state = _beside_certain(verdict.state) if certain.causes else verdict.state
    counts = any(part.field is not None for one in causes for part in one.parts)
    shrunk = shrink(step, "the record itself", counts) if causes else None
    the_gap = gap(final, step, causes, verdict.nats)
    sets = _ambiguous(causes) if state == "ambiguous" else ()
    unknown = _unknown(verdict, causes)
    return Diagnosis(
        state=state,
        headline=headline(
            state, gap=the_gap, causes=told, shrink=shrunk, ambiguous=sets, unknown=unknown,
            effects=len(kinds),
        ),
        causes=as_in_record(told, record.layout),
        gap=the_gap,
        shrink=shrunk,
        not_tested=not_tested,
        ambiguous=sets,
        unknown=unknown,
        tournament=_rows(rounds, accepted),
        geometry=geometry(record.layout),
        provenance=_provenance(record, final, seed, time.monotonic() - began),
    )  # fmt: skip


def _beside_certain(state: State) -> State:
    """The state where the screen has proved a cause besides."""
    beside: dict[State, State] = {"no_gap": "named", "unknown": "named_plus_remainder"}
    return beside.get(state, state)


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


def _cause(one: Named, space: Workspace) -> Cause:
    layout: Layout = space.signals.record.layout
    devices, planes = devices_and_planes(one.names)
    first = one.parts[0]
    onset = min(part.onset for part in one.parts)
    return Cause(
        effect=one.kind.id,
        stage=one.kind.stage,
        places=devices,
        planes=layout.planes[0] if len(layout.planes) == 1 else planes,
        parameters=values_of(one.kind, first, one.round.space),
        probability=one.probability,
        onset_s=float(space.signals.record.time[onset]) if onset else None,
        alternatives=tuple(dict.fromkeys((*one.rivals, *one.kind.also_called))),
        title=one.kind.title,
        sentence=one.kind.sentence,
        drop_one_nats=one.evidence,
    )


def _ambiguous(causes: Sequence[Named]) -> tuple[AmbiguousSet, ...]:
    first = causes[0]
    effects = (first.kind.id, *first.rivals)
    return (
        AmbiguousSet(
            effects=effects,
            why="their courses are alike in this record",
            splits=first.kind.splits,
        ),
    )


def _unknown(verdict: Judged, causes: Sequence[Named]) -> Unknown | None:
    if verdict.state not in ("unknown", "named_plus_remainder"):
        return None
    told = sum(one.evidence for one in causes)
    places = tuple(one.name for one in verdict.left[:12])
    target = verdict.left[0].target if verdict.left else "bpm"
    words = {"bpm": "BPM", "corrector": "corrector"}[target]
    text = (
        f"What is left follows the motion of {words} {places[0]} by a law that is not in the "
        "library."
        if places
        else ""
    )
    return Unknown(
        places=places, text=text, nearest=causes[0].kind.id if causes else "",
        nearest_nats=causes[0].evidence if causes else None,
        explained=told / (told + verdict.nats) if told else 0.0,
    )  # fmt: skip


def _rows(rounds: Sequence[Round], accepted: Sequence[object]) -> Tournament:
    rows: dict[str, TournamentRow] = {}
    chances = probabilities(rounds[0].candidates)
    for one in rounds[0].candidates:
        rows.setdefault(
            one.kind.id,
            TournamentRow(
                effect=one.kind.id,
                places=", ".join(one.names[:4]) or "all",
                nats=one.evidence,
                probability=chances[one.kind.id],
                accepted=bool(accepted) and one is rounds[0].candidates[0],
            ),
        )
    return Tournament(rows=tuple(rows.values()))


def _provenance(record: Record, space: Workspace, seed: int, seconds: float) -> Provenance:
    model = np.ascontiguousarray(record.layout.response)
    return Provenance(
        data_sha256=record.digest,
        seed=seed,
        versions=versions(),
        source=record.source,
        model_sha256=hashlib.sha256(model.tobytes()).hexdigest(),
        library_sha256=hashlib.sha256("\n".join(all_effects()).encode()).hexdigest(),
        ticks=len(record),
        bpms=len(record.layout.bpms),
        correctors=len(record.layout.correctors),
        planes="".join(record.layout.planes),
        period_s=record.layout.period,
        reading_noise_um=1e6 * float(np.sqrt(np.mean(np.diag(space.noise.white)))),
        drift_um_per_tick=1e6 * float(np.sqrt(np.mean(np.diag(space.noise.walk)))),
        gauge="the healthy scatter of all gains, with mean zero",
        thresholds={"sure_nats": SURE},
        seconds=seconds,
    )

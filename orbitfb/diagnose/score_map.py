"""Score of every place, stage by stage: where along the ring an effect would explain the gap.

For every stage one effect at one set of values: that of the causes, with their fitted values; the
best of the tournament where no cause is of the stage; else the plainest effect of it. Its change of
the prediction, scaled as is best at each place alone, would gain ½ s² / J with the score s and the
information J on it (`orbitfb.diagnose.scan`), on the record under the nominal model.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import ScoreMap, ScoreRow
from orbitfb.diagnose.answer_values import numbers
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.result.naming import column_names
from orbitfb.diagnose.scan_onsets import holding
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.diagnose.search import Outcome
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.registry import effect
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout

_STAGES = ("actuator", "sensor", "optics", "disturbance", "timing")
_PLAINEST = {"actuator": "corrector-gain", "sensor": "bpm-gain", "optics": "quadrupole-gradient"}
_CHANCE = 0.01
_LEAST_INFORMATION = 1e-3
"""Below which a change leaves no trace; it gains nothing [nats]."""


def score_map(outcome: Outcome) -> ScoreMap | None:
    """Score every place of one effect per stage; None where no effect with places can be scored.

    Args:
        outcome: Of the search.
    """
    bench = outcome.rounds[0].bench
    scoring = Scoring(bench)
    rows: list[ScoreRow] = []
    for stage in _STAGES:
        for cause in _of_stage(outcome, stage):
            gains = _gains(scoring, bench, cause)
            if gains is not None and np.any(gains > 0.0):
                rows.append(_row(outcome, cause, gains))
    if not rows:
        return None
    places = max(len(row.gain) for row in rows)
    return ScoreMap(rows=tuple(rows), threshold_nats=0.5 * float(chi2.isf(_CHANCE / places, 1)))


def _of_stage(outcome: Outcome, stage: str) -> Iterator[Cause]:
    """Causes of a stage; the best entry of the first tournament, or the plainest, if none is."""
    own: dict[str, Cause] = {}
    for cause in outcome.causes:
        if cause.kind.stage == stage and _has_places(cause.kind):
            own.setdefault(cause.kind.id, cause)
    if own:
        yield from own.values()
        return
    for entry in outcome.rounds[0].entries:
        if entry.kind.stage == stage and _has_places(entry.kind):
            yield entry.cause
            return
    if stage in _PLAINEST:
        kind = effect(_PLAINEST[stage])
        if not kind.unavailable(outcome.bench.record):
            yield Cause(kind, (), {p.name: p.typical for p in kind.parameters})


def _has_places(kind: EffectKind) -> bool:
    return isinstance(kind, ActuatorKind | SensorKind | SourceKind) and kind.target != "ring"


def _gains(scoring: Scoring, bench: Bench, cause: Cause) -> Vector | None:
    """Gain at every place, shape (P,); None where the record does not see the effect at all."""
    changes = scoring.changes(cause.kind, cause.values)
    if cause.onset:
        parts = tuple((shapes, _since(cause, drivers)) for shapes, drivers in changes.parts)
        changes = replace(changes, parts=parts)
    score = changes.score
    information, absorbed = changes.information
    known = information * (1.0 - absorbed)
    if score.shape != known.shape or not np.any(known > _LEAST_INFORMATION):
        return None
    if not cause.kind.sizes:
        score = np.maximum(score, 0.0)  # it cannot act the other way round
    return np.divide(
        0.5 * score**2, known, out=np.zeros_like(score), where=known > _LEAST_INFORMATION
    )


def _since(cause: Cause, drivers: Matrix) -> Matrix:
    """Course of a change that begins at the onset of the cause."""
    later = np.zeros_like(drivers)
    onset, rows = cause.onset, len(drivers)
    if cause.kind.grows:
        later[onset:] = drivers[: rows - onset]
    elif cause.free or holding(cause.kind):
        later[onset:] = drivers[onset:] - drivers[onset]
    else:
        later[onset:] = drivers[onset:]
    return later


def _row(outcome: Outcome, cause: Cause, gains: Vector) -> ScoreRow:
    kind = cause.kind
    layout = outcome.bench.record.layout
    names, plain = _names(layout, kind)
    fitted = {p for own in outcome.causes if own.kind.id == kind.id for p in own.places}
    within = {
        place
        for one in outcome.winners
        if one.accepted is not None and one.accepted.kind.id == kind.id
        for entry in one.places_within()
        for place in entry.cause.places
    }
    return ScoreRow(
        stage=kind.stage,
        effect=kind.id,
        gain=numbers(gains),
        s_m=_positions(layout, plain),
        names=names,
        fitted=tuple(sorted(fitted)),
        within=tuple(sorted(within - fitted)),
    )


def _names(layout: Layout, kind: EffectKind) -> tuple[tuple[str, ...], list[str]]:
    """Names of the places, and those of the devices there."""
    if isinstance(kind, SourceKind):
        names = kind.places_of(layout)
        return names, [name.split(" (")[0] for name in names]
    devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
    return column_names(devices), list(devices.names)


def _positions(layout: Layout, names: list[str]) -> tuple[float, ...]:
    """Where the places stand [m]; empty when that is not known of all."""
    if layout.ring is None:
        return ()
    table = layout.ring.table
    known = dict(zip(table.name, table.s.tolist(), strict=True))
    return tuple(known[name] for name in names) if all(n in known for n in names) else ()

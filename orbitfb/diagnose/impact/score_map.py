"""What an effect of every stage explains at every place of the ring."""

from collections.abc import Iterator, Sequence

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import worths_of
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.impact.named import Named
from orbitfb.diagnose.result.blocks import ScoreMap, ScoreRow
from orbitfb.diagnose.result.values import numbers
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.priors import ONCE_IN
from orbitfb.records.layout import Layout


def score_map(causes: Sequence[Named], first: Round, scorer: Scorer) -> ScoreMap | None:
    """Score the causes, and the best effect with places of every other stage.

    Args:
        causes: In their order.
        first: Round of the tournament, with all its candidates.
        scorer: Of that round.
    """
    own = {one.kind.id: one for one in causes}
    chosen: dict[str, Candidate] = {one.kind.stage: one.parts[0] for one in reversed(causes)}
    for one in first.candidates:
        if one.sources or one.columns:
            chosen.setdefault(one.kind.stage, one)
    rows = [row for one in chosen.values() for row in _rows(one, scorer, own.get(one.kind.id))]
    if not rows:
        return None
    places = max(len(row.gain) for row in rows)
    return ScoreMap(rows=tuple(rows), threshold_nats=float(np.log(places * ONCE_IN)))


def _rows(part: Candidate, scorer: Scorer, cause: Named | None) -> Iterator[ScoreRow]:
    law = _law(part, scorer)
    if law is None or law.periodic:
        return
    kind, space = part.kind, scorer.space
    values = part.sources[0].values if part.sources else dict(part.values)
    if not part.sources:
        values = {p.name: p.typical if p.name == kind.linear else values[p.name]
                  for p in kind.parameters}  # fmt: skip
    pull, information = scorer.apart(law, values, scorer.own_error(kind))
    gain = np.max([worth(pull, information) for worth, _ in worths_of(kind)], axis=0)
    fitted: set[int] = set()
    if cause is not None:
        fitted = {law.names.index(name) for name in cause.names if name in law.names}
    best = float(np.max(gain))
    within = np.flatnonzero(gain > best - 3.0) if cause is not None and len(fitted) == 1 else ()
    yield ScoreRow(
        stage=kind.stage, effect=kind.id, gain=numbers(gain),
        s_m=_places(kind, law, space.signals.record.layout), names=law.names,
        fitted=tuple(sorted(fitted)), within=tuple(int(one) for one in within),
    )  # fmt: skip


def _law(part: Candidate, scorer: Scorer) -> DeviceLaw | None:
    """The law of the same effect on the record that is scored."""
    laws = [one for one in scorer.space.courses.laws(part.kind) if isinstance(one, DeviceLaw)]
    return laws[0] if laws else None


def _places(kind: EffectKind, law: DeviceLaw, layout: Layout) -> tuple[float | None, ...]:
    """Where the devices stand [m]; empty where that is not known."""
    if layout.ring is None:
        return ()
    table = layout.ring.table
    where = dict(zip(table.name, table.s.tolist(), strict=True))
    found = [where.get(name.rpartition(" (")[0] or name) for name in law.names]
    return tuple(found) if any(one is not None for one in found) else ()

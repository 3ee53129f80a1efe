"""The gap of a record: how far the nominal model is from the best explanation and from the floor.

nats per tick: mean log-likelihood that the nominal model loses against the best explanation (the
causes that were found, and what a model of any kind predicts beyond them on ticks that it was not
fitted to), with the same floor and the same healthy errors. A floor from a reference record tells
more: what the best explanation leaves above it; that belongs to the gap as far as it is resolved.
A floor estimated with the record itself cannot tell that.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_parts import Gap
from orbitfb.diagnose.answer_values import numbers
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import Draws, Interval, interval
from orbitfb.diagnose.explain import explain
from orbitfb.diagnose.gap_maps import corrector_scores
from orbitfb.diagnose.gap_parts import bands, bins, windows
from orbitfb.diagnose.replay import NOMINAL, Model, Replay
from orbitfb.diagnose.result.naming import column_names
from orbitfb.diagnose.surplus import Surplus
from orbitfb.diagnose.unseen import Unseen
from orbitfb.diagnose.worth import Gains, shapley
from orbitfb.physics.optics import Matrix

STEADY = 0.01
"""Relative change of the noise's variance between reference and record that is nobody's gap."""
_SURE = 3.0
UNEXPLAINED = "unexplained"


def surplus(
    bench: Bench,
    *,
    best: Matrix | None = None,
    unseen: Unseen | None = None,
    reference_rows: int | None = None,
) -> Surplus:
    """Compare the nominal model with the best explanation, cell by cell.

    Args:
        bench: The record under the causes that were found.
        best: White innovations of an explanation better than the causes, on ticks it was not
            fitted to, shape (N, n) (`ceiling`); those of the causes when None.
        unseen: What causes without a course in time gain; None: there are none.
        reference_rows: Rows of the record that the floor comes from; as many as this one's when
            None. Without effect where the floor comes from the record itself.
    """
    replay = Replay.of(bench)
    counted = replay.counted()
    mine = Model(bench.causes)
    unseen = unseen or Unseen()
    even = np.where(counted, unseen.whole / max(int(counted.sum()), 1), 0.0)
    whole = Surplus(
        bench.floor,
        counted,
        replay.white(NOMINAL),
        replay.white(mine) if best is None else best,
        replay.jacobian(mine),
        even,
        unseen.where,
    )
    if not bench.told_floor:
        return whole
    left = explain(bench.record, bench.causes, bench.orbit).left
    raw = bench.floor.whiten(left, bench.record.starts)
    rest = 0.5 * np.sum(raw * bench.white - 1.0, axis=1)[counted]
    n, rows = bench.white.shape
    doubt = np.std(rest) / np.sqrt(len(rest))
    doubt = np.hypot(doubt, np.sqrt(n / 2.0 / (reference_rows or rows))) * _SURE
    if abs(float(rest.mean())) < doubt + 0.5 * n * STEADY:
        return whole
    return replace(whole, raw=raw)


def gap(
    bench: Bench,
    *,
    best: Matrix | None = None,
    unseen: Unseen | None = None,
    stage_gains: Mapping[str, float] | None = None,
    reference_rows: int | None = None,
    seed: int = 0,
    gains: Gains | None = None,
) -> Gap:
    """Measure the gap and take it apart; the parts add up to the whole.

    Args:
        bench: The record under the causes that were found (none: the nominal model).
        best: As for `surplus`.
        unseen: As for `surplus`.
        stage_gains: Best gains of the tournament by stage [nats over the record]; what no cause
            explains is shared out by them, as far as they reach.
        reference_rows: As for `surplus`.
        seed: Of the bootstrap.
        gains: Of the bench, where they are known already.
    """
    hidden = {} if unseen is None else unseen.by_stage
    whole = surplus(bench, best=best, unseen=unseen, reference_rows=reference_rows)
    draws = Draws.of(whole.counted, seed)
    ticks = max(int(whole.counted.sum()), 1)
    by_row = whole.by_row
    total = interval(draws.means(by_row))
    excess, by_bpm_um = _micrometres(bench, best, draws)
    cells = whole.by_bpm()
    names = column_names(bench.record.layout.bpms)
    directions = np.linalg.svd(bench.record.layout.response)[0]
    return Gap(
        nats_per_tick=total.value,
        low=total.low,
        high=total.high,
        um=excess.value,
        um_low=excess.low,
        um_high=excess.high,
        floor_um=1e6 * float(np.sqrt(Replay.of(bench).floor_variance())),
        resolved=total.resolved,
        by_stage=_by_stage(gains or Gains(bench), hidden, stage_gains or {}, total.value, ticks),
        by_bpm=dict(zip(names, (cells.sum(axis=0) / ticks).tolist(), strict=True)),
        by_corrector=corrector_scores(bench, whole, ticks),
        um_by_bpm=dict(zip(names, by_bpm_um.tolist(), strict=True)),
        by_mode=numbers(whole.by_direction(directions).sum(axis=0) / ticks),
        by_band=bands(whole, draws, bench.record.layout.period, ticks),
        by_window=windows(by_row, draws, bench.record.time, bench.record.layout.period),
        by_bin=bins(by_row, draws, bench.record),
        floor_from=_origin(bench, whole),
    )


def _origin(bench: Bench, whole: Surplus) -> str:
    if not bench.told_floor:
        return "the record itself, under the best explanation"
    if whole.raw is None:
        return "a reference; what is left above it is not resolved"
    return "a reference; what is left above it is a part of the gap"


def _micrometres(bench: Bench, best: Matrix | None, draws: Draws) -> tuple[Interval, Vector]:
    """Excess rms of the one-step prediction, of all BPMs and of each [µm]."""
    replay = Replay.of(bench)
    nominal, mine = replay.errors(NOMINAL), replay.errors(Model(bench.causes))
    squares = (nominal - mine) ** 2
    if best is not None:
        further = bench.floor.to_bpms((best - bench.white) * replay.deviation)
        squares += mine**2 - (mine + further) ** 2
    mean = draws.means(squares)
    overall = 1e6 * np.sqrt(np.maximum(mean.mean(axis=1), 0.0))
    return interval(overall), 1e6 * np.sqrt(np.maximum(mean[0], 0.0))


def _by_stage(
    gains: Gains,
    unseen: Mapping[str, float],
    stage_gains: Mapping[str, float],
    total: float,
    ticks: int,
) -> dict[str, float | None]:
    """Share the gap out: to the causes by Shapley, the rest by the best gains of the stages."""
    parts = {stage: gain / ticks for stage, gain in unseen.items()}
    for cause, share in zip(gains.causes, shapley(gains), strict=True):
        parts[cause.kind.stage] = parts.get(cause.kind.stage, 0.0) + share / ticks
    rest = total - sum(parts.values())
    positive = {stage: gain / ticks for stage, gain in stage_gains.items() if gain > 0.0}
    reach = max(sum(positive.values()), rest)
    if rest > 0.0 and reach > 0.0:
        for stage, gain in positive.items():
            parts[stage] = parts.get(stage, 0.0) + rest * gain / reach
    parts[UNEXPLAINED] = total - sum(parts.values())
    return dict(parts)

"""How far the gap shrinks on data that was used neither for fitting nor for selection.

Beside the causes stand two competitors: a black-box refit of R̂ and the forward net, both on the
ticks of the fit and scored on the same later ticks. A cause must beat a fit.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.answer_blocks import KStep
from orbitfb.diagnose.answer_parts import Shrink
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import interval
from orbitfb.diagnose.candidate import LAST_ONSET
from orbitfb.diagnose.competitor import refitted_response
from orbitfb.diagnose.contrast import Contrast
from orbitfb.diagnose.explain import Cause, actuated
from orbitfb.diagnose.integrity_steps import steps_of
from orbitfb.diagnose.net_competitor import NetCompetitor
from orbitfb.diagnose.open_errors import OpenErrors
from orbitfb.diagnose.replay import Model, Replay
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.records.record import Record

STEPS = (1, 2, 5, 10, 50)
_LEAST_TO_SPLIT = 500
"""Rows below which nothing is put aside: what is left would show too little."""
_FITTED = 0.8
_PHASES = 24
_SINCE = np.arange(0.0, 4.1, 0.25)
"""How long a drift may have gone on when a later record begins, in lengths of the first one."""
_NINETY = (0.05, 0.95)


def put_aside(record: Record) -> tuple[Record, Record | None]:
    """Keep the end of a record for what is used neither for fitting nor for selection.

    Returns:
        What is fitted, and what comes after it; None where the record is too short for that.
    """
    if len(record) < _LEAST_TO_SPLIT:
        return record, None
    cut = _beside_strikes(record, round(_FITTED * len(record)))
    return record.rows(0, cut), record.rows(cut, len(record))


def _beside_strikes(record: Record, cut: int) -> int:
    """Cut where something strikes in the rows before, in which no beginning is looked for."""
    steps = steps_of(record)
    left = (steps.orbit - steps.predicted) ** 2
    usual = np.median(left, axis=0)
    size = np.sum(np.divide(left, usual, out=np.zeros_like(left), where=usual > 0.0), axis=1)
    size -= np.median(size)
    rows = steps.first + 1
    before = size[rows < cut - LAST_ONSET]
    near = (rows >= cut - LAST_ONSET) & (rows < cut)
    if not len(before) or not near.any():
        return cut
    struck = rows[near][size[near] > _STRIKING * before.max()]
    return int(struck[0]) if len(struck) else cut


def contrast(
    bench: Bench,
    later: Record,
    seed: int = 0,
    rivals: Sequence[Cause] = (),
    net: NetCompetitor | None = None,
    *,
    beyond_healthy: bool = False,
) -> Contrast:
    """Bring the causes and their competitor to a later record.

    Args:
        bench: The record of the fit under the causes that were found.
        later: Of the same devices; nothing of the causes is fitted to it but the phase of a
            periodic disturbance (unless it is the end of the same record), and for how long a
            drift has gone on.
        seed: Of the bootstrap.
        rivals: The best few of the tournament that were not accepted, fitted to the same ticks.
        net: Fitted to the same ticks; None: left out.
        beyond_healthy: Whether healthy errors may do in the later record what the first one
            leaves open, so that only the rest of its gap counts.
    """
    rivals = tuple(replace(rival, onset=0) for rival in rivals)
    causes = tuple(
        replace(cause, onset=0, values=cause.kind.long_after(cause.values))
        for cause in bench.causes
    )
    same = bool(later.time[0] > bench.record.time[-1])
    later = _since_onset(bench, causes, _on_one_clock(bench.record, later))
    replay = Replay.later(bench, causes, later)
    if not same:
        causes = _in_phase(replay, causes)
    change = refitted_response(Replay.of(bench))
    orbit = None if net is None else net.extra(replay)
    healthy = None
    if beyond_healthy:
        healthy = OpenErrors(bench, replay.record, actuated(replay.record, causes), replay.orbit)
    return Contrast(replay, causes, change, seed, rivals, orbit, healthy)


def shrink(its: Contrast, on: str = "the later record", net_note: str = "") -> Shrink:
    """Tell which share of the gap is gone with the causes.

    Args:
        its: Of `contrast`.
        on: Which data that is.
        net_note: What there is to say about the forward net.

    Returns:
        Shares are null where the gap is not resolved in the later record, unless the causes make
        one there that is.
    """
    gained = its.likelihood(its.model)
    after = its.distance(its.mine)
    before = np.maximum(gained + after, 0.0)
    um_before, um_after, um_other = its.excesses([its.nominal, its.mine, its.other])
    um_net = None if its.second is None else its.excess(its.second)
    there = interval(its.distance(its.nominal))
    competitor = its.likelihood(its.competitor)
    nats, low, high = _share(gained, before)
    um, um_low, um_high = _share(um_before - um_after, um_before)
    told = there.resolved or (high is not None and high < 0.0)
    return Shrink(
        nats=nats if told else None,
        low=low if told else None,
        high=high if told else None,
        um=um if told else None,
        um_low=um_low if told else None,
        um_high=um_high if told else None,
        held_out_ticks=its.ticks,
        competitor_um=_share(um_before - um_other, um_before)[0],
        competitor_nats=_share(competitor, before)[0],
        net_um=None if um_net is None else _share(um_before - um_net, um_before)[0],
        net_note=net_note,
        resolved=there.resolved,
        on=on,
        before_nats_per_tick=float(before[0]),
        after_nats_per_tick=float(after[0]),
        before_um=float(um_before[0]),
        after_um=float(um_after[0]),
    )


def k_steps(its: Contrast, steps: Sequence[int] = STEPS) -> tuple[KStep, ...]:
    """Tell the excess of predictions many ticks ahead, of all models.

    Args:
        its: Of `contrast`.
        steps: How many ticks; those longer than the record are left out.
    """
    told: list[KStep] = []
    for step in steps:
        if not its.replay.counted(step).any():
            continue
        models = [its.nominal, its.mine, its.other]
        models += [] if its.second is None else [its.second]
        nominal, mine, other, *second = its.excesses(models, step)
        before, after = interval(nominal), interval(mine)
        told.append(
            KStep(
                k=step,
                nominal_um=before.value,
                nominal_low=before.low,
                nominal_high=before.high,
                effect_um=after.value,
                effect_low=after.low,
                effect_high=after.high,
                competitor_um=float(other[0]),
                net_um=float(second[0][0]) if second else None,
                floor_um=1e6 * float(np.sqrt(its.replay.floor_variance(step))),
                resolved=before.resolved,
            )
        )
    return tuple(told)


def _share(part: Vector, whole: Vector) -> tuple[float | None, float | None, float | None]:
    """Share of the record itself, and the ends of its interval; None where there is no gap."""
    if not whole[0] > 0.0:
        return None, None, None
    known = whole > 0.0
    shares = np.where(known, part / np.where(known, whole, 1.0), -np.inf)
    low, high = np.quantile(shares[1:], _NINETY, method="inverted_cdf")
    return float(shares[0]), min(float(low), float(shares[0])), max(float(high), float(shares[0]))


def _on_one_clock(record: Record, later: Record) -> Record:
    """Count the time of a later record from the first row of the record, if their clocks agree."""
    since = later.began - record.began
    if since + later.time[0] <= record.time[-1]:
        return later
    return replace(later, time=later.time + since)


def _since_onset(bench: Bench, causes: Sequence[Cause], later: Record) -> Record:
    """Count the time of a later record from where a cause that grows has begun.

    Args:
        bench: The record of the fit, with the causes' onsets.
        causes: As they act in the later record.
        later: On the clock of that record, if it is later by it: what grew may have gone on. But
            it may have stopped, or been put right and begun again, as well: the time since then
            is the one that explains it best.
    """
    begun = [one.onset for one in bench.causes if one.kind.grows]
    if not begun:
        return later
    replay = Replay.later(bench, tuple(causes), later)
    model = Model(tuple(causes))
    start = float(bench.record.time[min(begun)])
    length = float(bench.record.time[-1]) - start
    here = replace(later, time=later.time - later.time[0])
    tried = [replace(here, time=here.time + length * step) for step in _SINCE]
    if later.time[0] > bench.record.time[-1]:
        tried.append(replace(later, time=later.time - start))
    costs = [
        float(np.sum(Replay(one, replay.floor, replay.orbit, replay.healthy).white(model) ** 2))
        for one in tried
    ]
    return tried[int(np.argmin(costs))]


def _in_phase(replay: Replay, causes: tuple[Cause, ...]) -> tuple[Cause, ...]:
    """Turn periodic disturbances into the phase of a record whose clock begins anew."""
    done = list(causes)
    for index, cause in enumerate(causes):
        if not (isinstance(cause.kind, SourceKind) and cause.kind.periodic):
            continue
        turned = [_turned(cause, angle) for angle in 2 * np.pi * np.arange(_PHASES) / _PHASES]
        costs = [float(np.sum(replay.white(Model((*done[:index], one))) ** 2)) for one in turned]
        done[index] = turned[int(np.argmin(costs))]
    return tuple(done)


def _turned(cause: Cause, angle: float) -> Cause:
    cosine, sine = cause.values["cosine"], cause.values["sine"]
    values = dict(cause.values) | {
        "cosine": cosine * np.cos(angle) - sine * np.sin(angle),
        "sine": cosine * np.sin(angle) + sine * np.cos(angle),
    }
    return replace(cause, values=values)


_STRIKING = 2.0
"""How much larger than all steps before one is that moves the cut."""

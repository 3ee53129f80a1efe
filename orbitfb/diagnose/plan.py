"""The recommended experiment: what would split causes that a record cannot, at the least cost.

Every excitation that the limits allow is simulated on top of the record at hand. What counts is
how fast it drives the best values of either cause away from the other, per µm of orbit and minute
of beam time. Where no excitation splits them (late readings against late correctors, noise against
noise) the answer is what the effects themselves say would.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.experiments.file import Plan
from orbitfb.diagnose.experiments.proposals import (
    ORBIT_LIMIT,
    Limits,
    Proposal,
    orbit_rms,
    proposals,
)
from orbitfb.diagnose.experiments.suspects import Suspect
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.plan_answer import ENOUGH, Option, advice, beside, longer, movement
from orbitfb.diagnose.plan_outlook import base_rows, loop_gains, outlook
from orbitfb.diagnose.plan_response import separation
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.records.record import Record
from orbitfb.safety.limits import LimitSettings

DEFAULT_MINUTES = 10.0
_LEAST_TICKS = 200
_GAINED = 1.5
"""By this factor an excitation must be better than the record's own activity."""
_LEAST = 3.0
"""Separation within the beam time below which no excitation is worth it [nats]."""
_SEEN = 2.0
"""That a cause is there takes half of what tells it from another one."""
_FINALISTS = 4
_FEWEST_ROWS = 100
_SHARES = (1.0, 1 / 3, 0.1)
"""Amplitudes that are tried, of what the limits allow."""


def limits_of(
    orbit_limit: float | None = None,
    minutes: float = DEFAULT_MINUTES,
    write: LimitSettings | None = None,
) -> Limits:
    """Put limits together.

    Args:
        orbit_limit: Rms orbit in both planes [m]; None: a tenth of the beam size.
        minutes: Beam time at most [min].
        write: Limits of a write; the defaults of the loop when None.
    """
    if orbit_limit is None:
        orbit, source = dict(ORBIT_LIMIT), "a tenth of a beam of 100 µm by 10 µm"
    else:
        orbit, source = {"x": orbit_limit, "y": orbit_limit}, f"{orbit_limit * 1e6:.3g} µm rms"
    return Limits(orbit, write or LimitSettings(), minutes, source)


def plan(
    bench: Bench,
    first: Cause,
    rivals: Sequence[Cause] = (),
    limits: Limits | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Find the experiment that splits a cause from all its rivals, or shows it better.

    Rivals that no movement of the correctors splits from it are named with what would.

    Args:
        bench: The record under the causes that are accepted; none of these is among them.
        first: With its best values.
        rivals: The same; none: it is told from no effect.
        limits: To be kept; the defaults when None.
        seed: Of random levels.
        progress: Told what is done and which share of all.

    Raises:
        EstimationError: The record is too short to be continued.
    """
    tell = progress or (lambda what, share: None)
    limits = limits or limits_of()
    record = bench.record
    rows = base_rows(record)
    if rows < _FEWEST_ROWS:
        raise EstimationError(
            f"{record.source}: no stretch has {_FEWEST_ROWS} rows to plan an experiment from"
        )
    gains = loop_gains(record)
    listed = list(
        proposals(record.layout, [_suspect(one, record) for one in (first, *rivals)], limits)
    )
    rated: list[Vector] = []
    for index, proposal in enumerate(listed):
        tell("planning", index / (len(listed) + _FINALISTS))
        excursion = proposal.waveform(record.layout, rows, seed)
        rated.append(_rates(bench, excursion, gains, first, rivals, False))
    allowed = limits.minutes * 60 / record.layout.period
    split = np.max(rated, axis=0) * allowed >= _LEAST if rivals else np.zeros(0, dtype=bool)
    left = [rival for rival, able in zip(rivals, split, strict=True) if not able]
    if rivals and not split.any():
        return advice(record.layout, [first, *rivals])
    told = [rival for rival, able in zip(rivals, split, strict=True) if able]
    causes = [first, *told]
    worst = [float(rates[split].min() if rivals else rates[0]) for rates in rated]
    order = sorted(range(len(listed)), key=lambda index: worst[index], reverse=True)
    options = [
        _option(bench, gains, causes, limits, listed[index], seed) for index in order[:_FINALISTS]
    ]
    tell("planning", 1.0)
    still = np.zeros((rows, record.setpoints.shape[1]))
    passive = float(_rates(bench, still, gains, first, told, True).min())
    if passive * allowed >= ENOUGH and max(o.rate for o in options) < _GAINED * passive:
        return beside(longer(record.layout, causes, passive), first, left)
    if max(option.rate for option in options) * allowed < _LEAST:
        return advice(record.layout, causes)
    within = [option for option in options if option.minutes <= limits.minutes]
    if within:
        best = min(within, key=lambda option: option.orbit * option.minutes)
    else:
        best = max(options, key=lambda option: option.rate)
    return beside(movement(record.layout, causes, best, limits, seed), first, left)


def plan_for(
    bench: Bench,
    kinds: Sequence[EffectKind],
    limits: Limits | None = None,
    against: EffectKind | None = None,
    seed: int = 1,
    progress: Progress | None = None,
) -> Plan:
    """Find the experiment for effects whose places and values are not known yet.

    Args:
        bench: The record.
        kinds: One effect that is to be seen better, or all that may compete: then the best one
            is split from the best other.
        limits: To be kept.
        against: Effect to be told apart from a single kind; None: its being there at all.
        seed: Of random levels.
        progress: Told what is done and which share of all.

    Raises:
        EstimationError: No effect leaves a trace, or the record is too short to be continued.
    """
    tell = progress or (lambda what, share: None)
    entries = tournament(bench, kinds, lambda what, share: tell(what, 0.6 * share))
    if not entries and len(kinds) > 1:
        raise EstimationError(f"{bench.record.source}: no effect leaves a trace to plan from")
    first = entries[0].cause if entries else _somewhere(kinds[0], bench.record)
    if entries and len(kinds) == 1 and entries[0].weight <= 0.0:  # its size is that of the noise
        first = replace(first, values=_typical(kinds[0]), onset=0)
    rivals: list[Cause] = []
    if against is not None:
        found = tournament(bench, [against])
        rivals = [
            found[0].cause if found else replace(first, kind=against, values=_typical(against))
        ]
    elif len(kinds) > 1:
        rivals = [entry.cause for entry in entries if entry.kind.id != first.kind.id][:1]
    rest: Progress = lambda what, share: tell(what, 0.6 + 0.4 * share)  # noqa: E731
    return plan(bench, first, rivals, limits, seed, rest)


def _suspect(cause: Cause, record: Record) -> Suspect:
    """Tell a cause by the columns that it strikes."""
    kind, places = cause.kind, list(cause.places)
    if isinstance(kind, PairKind):
        pairs = kind.pairs(record.layout)
        places = [int(column) for pair in places for column in pairs[pair]]
    return Suspect(kind, tuple(places), cause.values)


def _somewhere(kind: EffectKind, record: Record) -> Cause:
    """An effect of typical size at a place in the middle, when the record shows none."""
    layout = record.layout
    if isinstance(kind, LatentKind):
        count = 0
    elif isinstance(kind, PairKind):
        count = len(kind.pairs(layout))
    elif isinstance(kind, SourceKind | NoiseKind):
        count = len(kind.places_of(layout))
    else:
        count = {"corrector": len(layout.correctors), "bpm": len(layout.bpms)}.get(kind.target, 0)
    places = (count // 2,) if count and kind.target != "ring" else ()
    return Cause(kind, places, _typical(kind))


def _typical(kind: EffectKind) -> Values:
    return {parameter.name: parameter.typical for parameter in kind.parameters}


def _rates(
    bench: Bench,
    excursion: Vector,
    gains: Vector,
    first: Cause,
    rivals: Sequence[Cause],
    exact: bool,
) -> Vector:
    """Expected separation per tick from every rival; the least of both directions where exact.

    It is no use to tell causes apart of which none is seen: from none at all counts too then.
    """
    view = outlook(bench, excursion, gains, exact=exact)
    if not rivals:
        return np.array([separation(view, first, None)]) / len(excursion)
    worth = [separation(view, first, rival) for rival in rivals]
    if exact:
        seen = _SEEN * separation(view, first, None)
        worth = [
            min(w, seen, separation(view, r, first)) for w, r in zip(worth, rivals, strict=True)
        ]
    return np.array(worth) / len(excursion)


def _option(
    bench: Bench,
    gains: Vector,
    causes: Sequence[Cause],
    limits: Limits,
    proposal: Proposal,
    seed: int,
) -> Option:
    """Judge at full amplitude, and at smaller ones where they are enough."""
    layout, rows = bench.record.layout, base_rows(bench.record)
    found: list[Option] = []
    for share in _SHARES:
        amplitude = tuple(share * each for each in proposal.part.amplitude)
        scaled = replace(proposal, part=proposal.part.model_copy(update={"amplitude": amplitude}))
        excursion = scaled.waveform(layout, rows, seed)
        rate = float(_rates(bench, excursion, gains, causes[0], causes[1:], True).min())
        ticks = max(_LEAST_TICKS, ENOUGH / max(rate, 1e-12))
        orbit = max(float(orbit_rms(layout, excursion, plane).max()) for plane in layout.planes)
        minutes = ticks * layout.period / 60
        found.append(Option(scaled, rate, minutes, orbit, float(np.abs(excursion).max())))
    enough = [option for option in found if option.minutes <= limits.minutes]
    return min(enough, key=lambda o: o.orbit * o.minutes) if enough else found[0]

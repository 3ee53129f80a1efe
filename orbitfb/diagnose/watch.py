"""A cheap look at the gap of the last ticks: scan all effects, fit the best ones, no more.

It says whether there is a gap, how large, and what is suspected. It is no diagnosis: one cause
only, no classes, no held-out record.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.gap import GapSight
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.diagnose.ambiguity import NATS
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import Draws, interval
from orbitfb.diagnose.broken import BREAKING
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import fit
from orbitfb.diagnose.load_rows import Transition, join
from orbitfb.diagnose.proposals import propose
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.effects.registry import all_effects
from orbitfb.records.layout import Devices, Layout
from orbitfb.records.record import Record

FEWEST = 200
"""Ticks below which nothing is said."""
SURE = 0.99
"""Probability that there is any effect, at which a gap is resolved."""
_FITTED = 4
"""Candidates that are fitted."""
_OF_A_KIND = 2
"""Those among them that one effect may take."""

_SIMPLE = ("bpm-stuck", "corrector-stuck", "bpm-polarity", "corrector-polarity")
"""What is named first among effects that break the same device as well."""

_Judged = tuple[float, Cause, Vector, float]
"""Evidence [nats], cause, gain by row, and among how many places it was chosen."""


def record_of(transitions: Transitions, layout: Layout) -> Record | None:
    """Make a record of the closed, usable transitions; None when there are too few.

    Args:
        transitions: Of the loop.
        layout: Of all its channels.
    """
    usable = transitions.usable & transitions.closed & np.isfinite(transitions.time)
    usable &= np.isfinite(transitions.setpoints).all(axis=1)
    usable &= np.isfinite(transitions.orbit).any(axis=1)
    if int(usable.sum()) < FEWEST:
        return None
    rows = Transition(
        time=transitions.time,
        orbit=transitions.orbit,
        next_orbit=transitions.next_orbit,
        setpoints=transitions.setpoints,
        requested=transitions.applied,
        follows=~transitions.starts()[1:],
        readback=None,
        dither=transitions.dither,
        reference=transitions.reference,
        auxiliary={
            name: values
            for name, values in transitions.auxiliary.items()
            if np.isfinite(values[usable]).all()
        },
    ).take(usable)
    return join(rows, layout, "the last ticks of the service")[0]


def look(record: Record, stamp: float, kinds: Sequence[EffectKind] | None = None) -> GapSight:
    """Look at a record.

    Args:
        record: The last ticks.
        stamp: Of its last row [s since the epoch].
        kinds: That may be suspected; all that the record can show when None.
    """
    began = time.monotonic()
    able = [
        kind
        for kind in (all_effects().values() if kinds is None else kinds)
        if not kind.unavailable(record)
    ]
    bench = Bench(record)
    judged = [_judged(bench, candidate) for candidate in _foremost(propose(bench, able))]
    judged.sort(key=lambda one: one[0], reverse=True)
    if judged:
        judged += [_judged(bench, one) for one in _harder(record, able, judged[0])]
        judged.sort(key=lambda one: one[0], reverse=True)
    chance = _probabilities([weight for weight, *_ in judged], len(able))
    nothing = GapSight(stamp, len(record), 0.0, 0.0, 0.0, False)
    if not judged or judged[0][0] <= 0.0:
        return _timed(nothing, began)
    alike = [index for index, one in enumerate(judged) if _broken_alike(judged[0], one)]
    as_good = [index for index in alike if judged[0][0] - judged[index][0] <= NATS]
    leader = min(as_good, key=lambda index: (judged[index][1].kind.id not in _SIMPLE, index))
    _, cause, by_row, _ = judged[leader]
    size = interval(Draws.of(~record.starts, 0).means(by_row))
    onset = stamp - (record.time[-1] - record.time[cause.onset])
    names, planes = places_of(cause, record.layout)
    sight = GapSight(
        time=stamp,
        ticks=len(record),
        nats=size.value,
        low=size.low,
        high=size.high,
        resolved=bool(chance.sum() >= SURE and size.low > 0.0),
        effect=cause.kind.id,
        places=names,
        planes=planes,
        probability=min(1.0, float(chance[alike].sum())),
        since=float(onset),
    )
    return _timed(sight, began)


def places_of(cause: Cause, layout: Layout) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name the devices of a cause, with their planes; empty for the whole ring."""
    devices: Devices | None = {"bpm": layout.bpms, "corrector": layout.correctors}.get(
        cause.kind.target
    )
    if devices is None:
        if not isinstance(cause.kind, SourceKind):
            return (), ()
        known = cause.kind.places_of(layout)
        return tuple(known[place] for place in cause.places), ("",) * len(cause.places)
    columns = list(cause.places)
    if isinstance(cause.kind, PairKind):
        columns = [c for place in cause.places for c in cause.kind.struck(layout, place)]
    elif isinstance(cause.kind, NoiseKind):
        struck = cause.kind.patterns(layout)[:, columns].any(axis=1)
        columns = [int(column) for column in np.flatnonzero(struck)]
    names = tuple(devices.names[column] for column in columns)
    return names, tuple(devices.planes[column] for column in columns)


def _foremost(proposed: Sequence[Candidate]) -> list[Candidate]:
    """Take the best candidates, so that the rough scores of one effect crowd out no other."""
    taken: list[Candidate] = []
    for one in proposed:
        of_its_kind = sum(other.cause.kind is one.cause.kind for other in taken)
        if of_its_kind < _OF_A_KIND and len(taken) < _FITTED:
            taken.append(one)
    return taken


def _harder(record: Record, kinds: Sequence[EffectKind], found: _Judged) -> list[Candidate]:
    """List what may be broken where a device was found inexact: a gain of −1 is a stuck magnet."""
    _, cause, _, choices = found
    able = ActuatorKind if isinstance(cause.kind, ActuatorKind) else SensorKind
    if not isinstance(cause.kind, able):
        return []
    return [
        Candidate(replace(cause, kind=kind, values=kind.grid(record)[0]), 0.0, choices)
        for kind in kinds
        if kind.id in BREAKING and isinstance(kind, able) and kind.id != cause.kind.id
    ]


def _broken_alike(best: _Judged, other: _Judged) -> bool:
    """Whether both say that the same device is broken."""
    if best is other:
        return True
    same = best[1].places == other[1].places
    return same and {best[1].kind.id, other[1].kind.id} <= BREAKING


def _judged(bench: Bench, candidate: Candidate) -> _Judged:
    cause, price = candidate.cause, float(np.log(candidate.choices))
    rows = len(bench.record)
    if isinstance(cause.kind, NoiseKind | LatentKind):
        weight = candidate.gain - price - len(cause.kind.parameters)
        return weight, cause, np.full(rows, candidate.gain / rows), candidate.choices
    found = fit(bench, (cause,))
    return found.evidence - price, found.causes[0], found.gains_by_row, candidate.choices


def _probabilities(weights: Sequence[float], kinds: int) -> Vector:
    """Of every candidate; the rest is "none". Before the data, none is as likely as any."""
    logs = np.array([0.0, *(weight - np.log(max(kinds, 1)) for weight in weights)])
    shares = np.exp(logs - np.logaddexp.reduce(logs))
    return shares[1:]


def _timed(sight: GapSight, began: float) -> GapSight:
    return replace(sight, duration=time.monotonic() - began)

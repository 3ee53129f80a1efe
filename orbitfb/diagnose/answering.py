"""Put what a search found into the words of the answer."""

from collections.abc import Sequence

import numpy as np

from orbitfb.diagnose.answer_blocks import Tournament, TournamentRow
from orbitfb.diagnose.answer_parts import Cause as NamedCause
from orbitfb.diagnose.answer_parts import ParameterValue
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.blocks import Draws, Interval, interval
from orbitfb.diagnose.departure import Departure
from orbitfb.diagnose.entry import Entry
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit
from orbitfb.diagnose.nearby import Nearby, nearby
from orbitfb.diagnose.random_values import state
from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.diagnose.rounds import Round
from orbitfb.diagnose.search import Outcome
from orbitfb.diagnose.worth import Worths
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.records.layout import Layout


def named_causes(
    outcome: Outcome, departures: Sequence[Departure], worths: Worths
) -> tuple[NamedCause, ...]:
    """Write the causes of a search that have a name, those that explain most first.

    Args:
        outcome: Of the search.
        departures: Of the causes from their laws.
        worths: What each of them is worth.
    """
    causes = [
        _named(outcome, one, one.accepted, its, worths)
        for one, its in zip(outcome.winners, departures, strict=True)
        if one.accepted is not None and not its.nameless
    ]
    if causes and not outcome.winners[0].rivals():  # else the first one stands for its class
        causes.sort(key=lambda cause: cause.drop_one_nats or 0.0, reverse=True)
    return tuple(causes)


def _named(
    outcome: Outcome, one: Round, entry: Entry, departs: Departure, worths: Worths
) -> NamedCause:
    layout, kind = one.bench.record.layout, entry.kind
    cause, fitted = outcome.final(entry)
    chances = one.probabilities()
    alike = one.alike()
    within = {
        name
        for other in one.places_within()
        for name in place_names(layout, kind, other.cause.places)
    }
    around = nearby(one.bench, entry)
    for place in () if around is None else around.places:
        within.update(place_names(layout, kind, (place,)))
    own = place_names(layout, kind, cause.places)
    devices, planes = devices_and_planes(own)
    return NamedCause(
        effect=kind.id,
        stage=kind.stage,
        places=devices,
        planes=layout.planes[0] if len(layout.planes) == 1 else planes,
        parameters=_wherever(_parameters(cause, fitted, one.bench), around),
        probability=departs.chance * sum(chances.get(name, 0.0) for name in (kind.id, *alike)),
        onset_s=float(one.bench.record.time[cause.onset]) if cause.onset else None,
        alternatives=tuple(dict.fromkeys((*alike, *kind.also_called))),
        title=kind.title,
        sentence=kind.sentence,
        label=entry.candidate.group,
        places_within=tuple(sorted(within - set(own))),
        departs=departs.course,
        departs_nats=departs.nats,
        held_out_nats=entry.held_out,
        drop_one_nats=worths.lost_without(cause, entry),
        shapley=worths.share(cause, entry),
    )


def _parameters(cause: Cause, fitted: Fit | None, bench: Bench) -> dict[str, ParameterValue]:
    if fitted is None:
        return _random(cause, bench)
    values: dict[str, ParameterValue] = {}
    for index, (owner, parameter) in enumerate(fitted.parameters):
        if fitted.causes[owner] is not cause:
            continue
        value = cause.values[parameter.name]
        low, high = fitted.interval(index)
        values[parameter.name] = ParameterValue(
            value=value,
            low=low,
            high=high,
            unit=parameter.unit,
            at_bound=bool(
                np.isclose(value, parameter.low, rtol=1e-6, atol=0.0)
                or np.isclose(value, parameter.high, rtol=1e-6, atol=0.0)
            ),
            unstable=fitted.unstable[index],
        )
    for parameter in cause.kind.parameters:
        value = cause.values.get(parameter.name, parameter.nominal)
        if meaning := cause.kind.meaning(parameter, value, bench.record):
            values[parameter.name] = ParameterValue(
                value=value, unit=parameter.unit, meaning=meaning
            )
    return values


def _wherever(
    values: dict[str, ParameterValue], around: Nearby | None
) -> dict[str, ParameterValue]:
    """Widen the intervals of values to those of all places that the record leaves open."""
    wide = dict(values)
    for name, (low, high) in ({} if around is None else around.intervals).items():
        its = values.get(name)
        if its is not None and its.low is not None and its.high is not None:
            ends = {"low": min(low, its.low), "high": max(high, its.high)}
            wide[name] = its.model_copy(update=ends)
    return wide


def _random(cause: Cause, bench: Bench) -> dict[str, ParameterValue]:
    """Values of an effect without a course in time, from its spectrum or its strikes."""
    stated = state(bench, cause)
    return {
        p.name: ParameterValue(
            value=stated.cause.values[p.name],
            low=stated.intervals[p.name][0],
            high=stated.intervals[p.name][1],
            unit=p.unit,
        )
        for p in cause.kind.parameters
    }


def place_names(layout: Layout, kind: EffectKind, places: Sequence[int]) -> tuple[str, ...]:
    """Names of the devices of a cause; with their plane where the record has two."""
    if kind.target == "ring":
        return ()
    devices = layout.correctors if kind.target == "corrector" else layout.bpms
    single = len(layout.planes) == 1

    def name(column: int) -> str:
        return devices.names[column] if single else devices.label(column)

    if isinstance(kind, PairKind):
        columns = [column for place in places for column in kind.struck(layout, place)]
        return tuple(dict.fromkeys(name(column) for column in columns))
    if isinstance(kind, NoiseKind) and kind.target == "bpm":
        struck = kind.patterns(layout)[:, list(places)].any(axis=1)
        return tuple(name(int(column)) for column in np.flatnonzero(struck))
    if isinstance(kind, SourceKind | NoiseKind):
        known = kind.places_of(layout)
        return tuple(known[p].split(" (")[0] if single else known[p] for p in places)
    return tuple(name(column) for column in places)


def tournament_rows(outcome: Outcome, rest: Interval) -> Tournament:
    """Write the first tournament: every kind at its best place.

    Args:
        outcome: Of the search.
        rest: What a model of any kind gains beyond the causes, on held-out ticks [nats].
    """
    first = outcome.rounds[0]
    layout = first.bench.record.layout
    chances = first.probabilities()
    accepted = {one.accepted.kind.id for one in outcome.winners if one.accepted is not None}
    alike = (first.accepted.kind.id, *first.alike()) if first.accepted is not None else ()
    rows: dict[str, TournamentRow] = {}
    draws = Draws.of(~first.bench.record.starts, 0)
    for entry in first.entries:
        if entry.kind.id in rows:
            continue
        low = high = None
        if entry.fit is not None:
            spread = interval(draws.sums(entry.fit.held_out_by_row))
            low, high = spread.low, spread.high
        names = place_names(layout, entry.kind, entry.cause.places)
        members = alike if entry.kind.id in alike else (entry.kind.id,)
        rows[entry.kind.id] = TournamentRow(
            effect=entry.kind.id,
            places=entry.candidate.group or ", ".join(names[:3]),
            nats=entry.held_out,
            low=low,
            high=high,
            probability=sum(chances.get(name, 0.0) for name in members),
            members=members,
            accepted=entry.kind.id in accepted,
        )
    found = [one.accepted.held_out for one in outcome.winners if one.accepted is not None]
    ceiling = sum(found) + rest.value if rest.resolved else None
    return Tournament(rows=tuple(rows.values()), ceiling_nats=ceiling)

"""Causes and the tournament, in the form of the answer."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.impact.named import Named, probabilities
from orbitfb.diagnose.impact.pieces import Piece
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.result.blocks import (
    AmbiguousSet,
    ScoreMap,
    Tournament,
    TournamentRow,
    WaterfallStep,
)
from orbitfb.diagnose.result.headline import RING
from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.diagnose.result.parts import Cause, PlaceValues
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.diagnose.verdict.values import Measured
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.laws import EventLaw, RandomLaw
from orbitfb.estimation.priors import UNTOLD
from orbitfb.physics.places import Indices, Planes
from orbitfb.records.finding import listed
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_NAMED = 4
"""Places that a row of the tournament names."""


def cause_of(
    one: Named,
    parts: tuple[tuple[Piece, ...], ...],
    measured: Measured,
    scores: ScoreMap | None,
    explained: float,
) -> Cause:
    """Write a cause.

    Args:
        one: The cause.
        parts: Values of its devices, by its parts.
        measured: Tells the values.
        scores: Of the places along the ring.
        explained: Share of the gap that the causes explain [1]: if one effect that is in no
            library makes the rest, it may make this as well.
    """
    space = measured.scorer.space
    record = space.signals.record
    members = _members(one, space)
    pieces = tuple(
        replace(piece, names=_devices(piece.names, members)) for part in parts for piece in part
    )
    own = tuple(dict.fromkeys(name for piece in pieces for name in piece.names))
    all_of_them = one.kind.target == "bpm" and len(own) == len(record.layout.bpms)
    named = () if all_of_them or not one.names else own
    devices, planes = _places(named, record.layout)
    onset = min(piece.onset for piece in pieces)
    alike = len({(tuple(p.values.items()), p.onset) for p in pieces}) == 1 and len(one.parts) == 1
    alike = alike and not any(piece.elements for piece in pieces)
    return Cause(
        effect=one.kind.id,
        stage=one.kind.stage,
        places=devices,
        planes=planes,
        parameters=measured.values(one.kind, one.parts[0], parts[0]),
        probability=explained * one.probability,
        onset_s=_onset(onset, record),
        alternatives=tuple(dict.fromkeys((*one.rivals, *one.kind.also_called))),
        title=one.kind.title,
        sentence=one.kind.sentence,
        label=_label(one, named, record.layout) if named else "",
        places_within=tuple(_near(one, scores)),
        evidence_nats=one.evidence,
        scatter=one.parts[0].scattered,
        by_place=() if alike else tuple(_piece(piece, record) for piece in pieces),
    )


def struck_by(one: Named, space: Workspace) -> tuple[frozenset[str], int]:
    """Names of the devices that a cause strikes, and how many there are of their kind.

    Places between the devices are about as many as the BPMs. What strikes all of its kind strikes
    the ring, of which there is one. Errors of every size at all devices have no names: no model is
    without them.
    """
    if one.parts[0].scattered:
        return frozenset(), 0
    if not one.names:
        return frozenset({RING}), 1
    layout = space.signals.record.layout
    kind = layout.correctors if one.kind.target == "corrector" else layout.bpms
    return frozenset(_devices(one.names, _members(one, space))), len(kind)


def _members(one: Named, space: Workspace) -> Mapping[str, tuple[str, ...]]:
    """Devices of the groups that have something random in common, by the name of the group."""
    layout = space.signals.record.layout
    devices = {"bpm": layout.bpms, "corrector": layout.correctors}.get(one.kind.target)
    found: dict[str, tuple[str, ...]] = {}
    if devices is None:
        return found
    for law in space.courses.laws(one.kind):
        groups: Iterable[tuple[str, Indices]] = ()
        if isinstance(law, EventLaw):
            groups = law.parts.items()
        elif isinstance(law, RandomLaw) and one.kind.target == "bpm":
            groups = zip(law.names, map(np.flatnonzero, law.patterns.T), strict=True)
        for name, columns in groups:
            found[name] = tuple(devices.label(int(column)) for column in columns)
    return found


def _devices(names: Sequence[str], members: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(its for name in names for its in members.get(name, (name,))))


def _label(one: Named, names: tuple[str, ...], layout: Layout) -> str:
    """Name the cells, where all devices of some cells are struck and no others."""
    devices = {"bpm": layout.bpms, "corrector": layout.correctors}.get(one.kind.target)
    if devices is None:
        return ""
    struck = {column for column in range(len(devices)) if devices.label(column) in names}
    whole = {cell: its for cell, its in devices.groups().items() if struck.issuperset(its.tolist())}
    if sum(map(len, whole.values())) != len(struck) or len(struck) <= len(whole):
        return ""
    return f"cell{'s' if len(whole) > 1 else ''} {listed(tuple(whole))}"


def _near(one: Named, scores: ScoreMap | None) -> Iterator[str]:
    """Other places that the record cannot exclude, where one is named."""
    for row in () if scores is None else scores.rows:
        if row.effect == one.kind.id:
            yield from devices_and_planes(
                tuple(row.names[place] for place in row.within if place not in row.fitted)
            )[0]


def _piece(piece: Piece, record: Record) -> PlaceValues:
    devices, planes = _places(piece.names, record.layout)
    return PlaceValues(
        places=devices, planes=planes, values=dict(piece.values),
        onset_s=_onset(piece.onset, record), elements=dict(piece.elements),
    )  # fmt: skip


def _places(names: Sequence[str], layout: Layout) -> tuple[tuple[str, ...], Planes]:
    devices, planes = devices_and_planes(names)
    return devices, layout.planes[0] if len(layout.planes) == 1 else planes


def _onset(row: int, record: Record) -> float | None:
    return float(record.time[row]) if row > UNTOLD else None


def ambiguous_sets(causes: Sequence[Named]) -> tuple[AmbiguousSet, ...]:
    """Effects that the record cannot tell from the first cause."""
    first = causes[0]
    return (
        AmbiguousSet(
            effects=(first.kind.id, *first.rivals),
            why="they change this record in the same way",
            splits=first.kind.splits,
        ),
    )


def tournament_of(
    kinds: Sequence[EffectKind], rounds: Sequence[Round], accepted: Sequence[Candidate]
) -> Tournament:
    """Write the first round: every effect at its best places, the best first.

    Args:
        kinds: All that were tried; those of which the record shows nothing come last.
        rounds: Of the tournament.
        accepted: Candidates.
    """
    first = rounds[0]
    chances = probabilities(first.candidates)
    found = {one.kind.id for one in accepted}
    rows: dict[str, TournamentRow] = {}
    for one in first.candidates:
        if one.kind.id not in rows:
            rows[one.kind.id] = TournamentRow(
                effect=one.kind.id,
                places=", ".join(one.names[:_NAMED]) or "all",
                nats=one.evidence,
                probability=chances.get(one.kind.id, 0.0),
                accepted=one.kind.id in found,
            )
    for kind in kinds:
        rows.setdefault(kind.id, TournamentRow(effect=kind.id, nats=0.0))
    free = first.free[0].evidence if first.free else None
    return Tournament(rows=tuple(rows.values()), free_nats=free)


def waterfall_of(
    causes: Sequence[Named], shares: Sequence[float], whole: float, ticks: int
) -> tuple[WaterfallStep, ...]:
    """Tell what is left of the gap as one cause after the other joins the model [nats/tick]."""
    steps = [WaterfallStep(label="nominal model", left_nats=whole / ticks)]
    left = whole
    for one, share in zip(causes, shares, strict=True):
        left -= share
        steps.append(WaterfallStep(label=f"+ {one.kind.id}", left_nats=left / ticks))
    return tuple(steps)

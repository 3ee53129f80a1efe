"""Causes, the tournament and what is left, in the form of the answer."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.free_course import FreeCourse
from orbitfb.diagnose.impact.named import Named, probabilities
from orbitfb.diagnose.impact.pieces import Piece
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.result.blocks import (
    AmbiguousSet,
    ScoreMap,
    Tournament,
    TournamentRow,
    Unknown,
    WaterfallStep,
)
from orbitfb.diagnose.result.headline import RING
from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.diagnose.result.parts import Cause, PlaceValues
from orbitfb.diagnose.selection.rounds import Round
from orbitfb.diagnose.verdict.proved import Untold
from orbitfb.diagnose.verdict.state import Judged
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

_WHERE = 12
"""Devices at which a remainder is said to sit, at most."""


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


def unknown_of(
    verdict: Judged, causes: Sequence[Named], untold: Sequence[Untold] = ()
) -> Unknown | None:
    """Tell what is known of what no effect explains.

    Args:
        verdict: On the record without what the screen proves.
        causes: Found in it.
        untold: What the screen proves, and has no name.
    """
    proved = " ".join(one.text for one in untold)
    if verdict.state not in ("unknown", "named_plus_remainder"):
        if not untold or verdict.state == "ambiguous":
            return None
        return Unknown(places=tuple(name for one in untold for name in one.devices), text=proved)
    told = sum(one.evidence for one in causes)
    places = tuple(dict.fromkeys(name for one in verdict.left[:_WHERE] for name in one.names))
    text, what = "", "The gap" if verdict.state == "unknown" else "The rest"
    if verdict.improper is not None:
        poor = verdict.improper
        places = poor.names[:_WHERE]
        where = f" at {listed(poor.names[:_NAMED])}" if poor.names else ""
        text = (
            f"{what}{where} looks most like {poor.kind.title}, but {poor.lacks}: a simpler law "
            "does the same, which is not in the library or was left out."
        )
    elif verdict.rest is not None:
        places = verdict.rest.names[:_WHERE]
        text = (
            f"The rest looks most like {verdict.rest.kind.title}. If so many effects seem to act "
            "at once, one effect that is not in the library is more likely."
        )
    elif verdict.left:
        text = _of_free(verdict.left[0], what)
    elif verdict.shared:
        ring = verdict.shared == (RING,)
        places = () if ring else verdict.shared[:_WHERE]
        text = (
            f"Two effects {'of the whole ring' if ring else 'at the very same devices'} would be a "
            "coincidence. One effect that looks like both, and is not in the library, is more "
            "likely."
        )
    elif verdict.state == "named_plus_remainder":
        text = "One effect that is not in the library may make all of it, rest and causes."
    return Unknown(
        places=places,
        text=" ".join(filter(None, (text, proved))),
        nearest=causes[0].kind.id if causes else "",
        nearest_nats=causes[0].evidence if causes else None,
        explained=verdict.explained if told else 0.0,
    )


def _of_free(first: FreeCourse, what: str) -> str:
    """Say what a free course found.

    Args:
        first: The most telling one.
        what: The gap, or the rest.
    """
    names = listed(first.names[:_NAMED])
    at = f" at {names}" if first.names else ""
    if first.target == "noise":
        where = f"BPM {first.names[0]}" if first.names else "all BPMs"
        return (
            f"The noise of {where} grows or shrinks with how far or how fast the beam moves there, "
            "by a law that is not in the library."
        )
    if first.target == "shared":
        return f"The BPMs {names} have noise in common, in a way that is not in the library."
    if first.target == "varying":
        return (
            f"What was named{at} is not the same all the time: it comes and goes, or it is "
            "another law."
        )
    if first.target == "spectrum":
        return f"What was named{at} has not the spectrum of its law: it is another random one."
    if first.target == "source":
        return (
            f"{what} is like kicks at {first.names[0]}, whose course in time is not in the library."
        )
    device = {"bpm": "BPM", "corrector": "corrector"}[first.target]
    where = f"all {device}s alike"
    if first.names:
        where = f"the {device}s of {first.cell}" if first.cell else f"{device} {first.names[0]}"
    return f"{what} follows the motion of {where}, by a law that is not in the library."


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

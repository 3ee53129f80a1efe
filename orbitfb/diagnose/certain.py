"""Effects that the integrity screen proves: named without a tournament, and taken out of it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.answer_parts import Cause
from orbitfb.diagnose.explain import Cause as Explaining
from orbitfb.diagnose.finding import Finding, listed
from orbitfb.diagnose.integrity_repeats import HELD, shared_repeats
from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.diagnose.tournament import Shown
from orbitfb.effects.device_kinds import PairKind
from orbitfb.effects.kinds import Stage
from orbitfb.effects.registry import all_effects
from orbitfb.physics.places import Indices
from orbitfb.records.gaps import gaps_of, is_gap
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_CERTAIN = ("bpm-stuck", "missed-read")
"""Taken out of the record."""
_GIVEN = ("bpm-polarity", "bpm-swap", "corrector-polarity", "corrector-swap")
"""Without a size to estimate: put into the model before anything else is looked for."""
_PROBABILITY = 0.995
_MOST_REPEATS = 0.5
"""Share of repeated orbits beyond which filling them in would be inventing a record."""


@dataclass(frozen=True, slots=True)
class Untold:
    """What the screen proves, and no cause may be called.

    Args:
        stage: Where it comes from.
        devices: Names of the devices concerned.
        text: What it is, a sentence.
    """

    stage: Stage
    devices: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Certain:
    """What is certain, and the record without it.

    Args:
        causes: In the form of the answer.
        record: Without the BPMs that stand still; orbits that were read twice are filled in.
        given: Causes that the model has from the beginning.
        untold: What is proved and has no name: a gap, whatever the record shows besides.
    """

    causes: tuple[Cause, ...]
    record: Record
    given: tuple[Explaining, ...] = ()
    untold: tuple[Untold, ...] = ()

    def without_given(self) -> "Certain":
        """The same without what was put into the model: it did not explain the record."""
        kept = tuple(cause for cause in self.causes if cause.effect not in _GIVEN)
        return Certain(kept, self.record, (), self.untold)


def certain_causes(record: Record, findings: Sequence[Finding], without: frozenset[str]) -> Certain:
    """Take what the integrity screen proves out of a record.

    Args:
        record: As read.
        findings: Of the screen.
        without: Ids of effects that must not be named.
    """
    causes, untold = list[Cause](), list[Untold]()
    held = tuple(name for f in findings if f.check == HELD for name in f.devices)
    if held:
        text = f"Readings of {listed(held)} were held, not read: they are left out."
        untold.append(Untold("sensor", held, text))
    labels = [record.layout.bpms.label(i) for i in range(len(record.layout.bpms))]
    names = record.layout.bpms.names
    frozen = {index for index, label in enumerate(labels) if label in held}
    for finding in findings:
        told = finding.effect in (*_CERTAIN, *_GIVEN)
        if not told or not (finding.devices or finding.effect == "missed-read"):
            continue
        if finding.effect == "bpm-stuck":
            frozen |= {i for i in range(len(names)) if {names[i], labels[i]} & set(finding.devices)}
        if finding.effect not in without:
            causes.append(_cause(record, finding))
        else:
            stage = all_effects()[finding.effect].stage
            text = f"{finding.text[0].upper()}{finding.text[1:]}."
            untold.append(Untold(stage, finding.devices, text))
    cut = _without_repeats(record)
    if frozen and len(frozen) < len(names) - 2:
        keep = np.array([i for i in range(len(names)) if i not in frozen], dtype=np.intp)
        cut = with_bpms(cut, keep)
    proved = [f for f in findings if f.effect in _GIVEN and f.effect not in without]
    given = [cause for finding in proved for cause in _given(cut.layout, finding)]
    return Certain(tuple(causes), cut, tuple(given), tuple(untold))


def shown_by(findings: Sequence[Finding], record: Record) -> Shown:
    """List what readbacks show, and at which corrector: evidence, where several laws would do."""
    devices = record.layout.correctors
    return frozenset(
        (finding.effect, column)
        for finding in findings
        if finding.effect and all_effects()[finding.effect].target == "corrector"
        for column in range(len(devices))
        if {devices.names[column], devices.label(column)} & set(finding.devices)
    )


def _given(layout: Layout, finding: Finding) -> list[Explaining]:
    """What a finding proves, as the model takes it; nothing if its devices are not there."""
    kind = all_effects()[finding.effect]
    devices = layout.correctors if kind.target == "corrector" else layout.bpms
    named = set(finding.devices)
    columns = [i for i in range(len(devices)) if {devices.names[i], devices.label(i)} & named]
    if not isinstance(kind, PairKind):
        return [Explaining(kind, (column,), {}) for column in columns]
    pairs = kind.pairs(layout)
    fits = np.isin(pairs, columns).all(axis=1) & (pairs[:, 0] != pairs[:, 1])
    return [Explaining(kind, (int(place),), {}) for place in np.flatnonzero(fits)[:1]]


def _cause(record: Record, finding: Finding) -> Cause:
    kind = all_effects()[finding.effect]
    first = finding.rows[0] if finding.rows and finding.effect == "bpm-stuck" else 0
    devices, planes = devices_and_planes(finding.devices)
    layout = record.layout
    return Cause(
        effect=kind.id,
        stage=kind.stage,
        places=devices,
        planes=layout.planes[0] if len(layout.planes) == 1 else planes,
        probability=_PROBABILITY,
        onset_s=float(record.time[first]) if first > 1 else None,
        title=kind.title,
        sentence=kind.sentence,
    )


def _without_repeats(record: Record) -> Record:
    """Fill in readings that repeat the ones before, whole orbits or crates at once.

    They are taken from those before and after.
    """
    whole = np.zeros(len(record), dtype=np.bool_)
    whole[1:] = (record.readings[1:] == record.readings[:-1]).all(axis=1)
    whole &= ~record.starts
    same = shared_repeats(record) | whole[:, None]
    rows = same.any(axis=1)
    if not rows.any() or rows.mean() > _MOST_REPEATS:
        return record
    readings = record.readings.copy()
    moved = np.zeros_like(readings)
    moved[1:] = np.diff(record.setpoints, axis=0) @ record.layout.response.T
    for row in np.flatnonzero(rows):
        own = same[row]
        ahead = readings[row - 1] + moved[row]
        back = ahead
        if row + 1 < len(record) and not record.starts[row + 1]:
            back = np.where(same[row + 1], ahead, readings[row + 1] - moved[row + 1])
        readings[row, own] = 0.5 * (ahead + back)[own]
    return replace(record, readings=readings, filled=record.filled | same)


def beside(other: Record, record: Record) -> Record:
    """Cut another record of the same machine down to the BPMs that a record has left.

    It has the gaps of the record too, as their number is their name: those that it lacks stand
    still, those that the record lacks are left out.
    """
    if gaps_of(record).keys() != gaps_of(other).keys():
        still = {name: np.zeros(len(other)) for name in gaps_of(record)}
        known = {n: v for n, v in other.auxiliary.items() if n in still or not is_gap(n)}
        other = replace(other, auxiliary=still | known)
    mine, its = record.layout.bpms, other.layout.bpms
    left = {mine.label(i) for i in range(len(mine))}
    keep = np.array([i for i in range(len(its)) if its.label(i) in left], dtype=np.intp)
    return other if len(keep) == len(its) else with_bpms(other, keep)


def with_bpms(record: Record, keep: Indices) -> Record:
    """The record of some of its BPMs."""
    layout = record.layout
    smaller = replace(layout, bpms=layout.bpms.only(keep), response=layout.response[keep])
    return replace(
        record,
        layout=smaller,
        readings=record.readings[:, keep],
        reference=None if record.reference is None else record.reference[:, keep],
        filled=record.filled[:, keep],
    )

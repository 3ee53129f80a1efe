"""Effects that the integrity screen proves: named without a tournament, and taken out of it."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.result.naming import devices_and_planes
from orbitfb.diagnose.result.parts import Cause
from orbitfb.diagnose.screen.missing import drawn
from orbitfb.diagnose.screen.rails import RAIL
from orbitfb.diagnose.screen.repeats import HELD, unread
from orbitfb.effects.registry import all_effects
from orbitfb.estimation.priors import MOST_REPEATS, PROVED
from orbitfb.physics.places import Indices
from orbitfb.records.finding import Finding, listed
from orbitfb.records.gaps import gaps_of, is_gap
from orbitfb.records.record import Record

SCREENED = ("bpm-stuck", "missed-read")
"""Effects that leave exact repeats: the integrity screen is certain of them, or they are not."""

NOT_THE_BEAM = {HELD: "held, not read", RAIL: "clipped"}
"""Checks that find BPMs some of whose readings are not of the beam, and what these are."""


@dataclass(frozen=True, slots=True)
class Untold:
    """What the screen proves, and no cause may be called.

    Args:
        devices: Names of the devices concerned.
        text: What it is, a sentence.
    """

    devices: tuple[str, ...]
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Proved:
    """What is certain, and the record without it.

    Args:
        causes: In the form of the answer.
        record: Without the BPMs that stand still; readings that were not read are drawn.
        untold: What is proved and has no name: a gap, whatever the record shows besides.
    """

    causes: tuple[Cause, ...]
    record: Record
    untold: tuple[Untold, ...] = ()


def proved(record: Record, findings: Sequence[Finding], without: frozenset[str]) -> Proved:
    """Take what the integrity screen proves out of a record.

    Args:
        record: As read.
        findings: Of the screen.
        without: Ids of effects that must not be named.
    """
    told = [
        finding
        for finding in findings
        if finding.effect in SCREENED and (finding.devices or finding.effect == SCREENED[1])
    ]
    causes = tuple(_cause(record, one) for one in told if one.effect not in without)
    false = {
        what: tuple(name for one in _warned(findings, check) for name in one.devices)
        for check, what in NOT_THE_BEAM.items()
    }
    stuck = {name for one in told if one.effect == SCREENED[0] for name in one.devices}
    bpms = record.layout.bpms
    names = stuck.union(*false.values())
    out = {i for i in range(len(bpms)) if {bpms.names[i], bpms.label(i)} & names}
    cut = _without_repeats(record)
    if out and len(out) < len(bpms) - 2:
        cut = with_bpms(cut, np.array(sorted(set(range(len(bpms))) - out), dtype=np.intp))
    return Proved(causes, cut, tuple(_untold(told, false, without)))


def _warned(findings: Sequence[Finding], check: str) -> list[Finding]:
    """Take what a check is sure of: a note is none."""
    return [one for one in findings if one.check == check and one.severity == "warning"]


def _untold(
    told: Sequence[Finding], false: Mapping[str, tuple[str, ...]], without: frozenset[str]
) -> Iterator[Untold]:
    """What is proved and has no name, or may not have it."""
    for what, names in false.items():
        if names:
            yield Untold(names, f"Readings of {listed(names)} were {what}: they are left out.")
    for one in told:
        if one.effect in without:
            yield Untold(one.devices, f"{one.text[:1].upper()}{one.text[1:]}.")


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


def _cause(record: Record, finding: Finding) -> Cause:
    kind = all_effects()[finding.effect]
    first = finding.rows[0] if finding.rows and finding.effect == SCREENED[0] else 0
    devices, planes = devices_and_planes(finding.devices)
    layout = record.layout
    return Cause(
        effect=kind.id,
        stage=kind.stage,
        places=devices,
        planes=layout.planes[0] if len(layout.planes) == 1 else planes,
        probability=PROVED,
        onset_s=float(record.time[first]) if first > 1 else None,
        title=kind.title,
        sentence=kind.sentence,
    )


def _without_repeats(record: Record) -> Record:
    """Draw readings that repeat the ones before, and whatever else was not read."""
    same = unread(record)
    if same.mean() > MOST_REPEATS:
        return record
    return drawn(replace(record, filled=record.filled | same))

"""The tournament: every kind of effect, at every place, against every other and against none.

Each kind proposes its best candidates (scan); the best of all are fitted exactly; each has an
evidence: what the likelihood gains, over the scatter of its scores beyond the noise model, less
what the choice of values, place, onset and kind costs. Nothing here is calibrated on a library of
cases: a candidate that is wrong leaves scores that scatter more than they should, and pays.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.around import around
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.budget import SCAN_SHARE, Budget
from orbitfb.diagnose.candidate import FIRST_ONSET, Candidate
from orbitfb.diagnose.entry import (
    HOPELESS,
    Entry,
    enter,
    net,
    profiled,
)
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.proposals import propose
from orbitfb.diagnose.same_group import other_laws
from orbitfb.diagnose.same_law import alike_alike, devices, limits, says_little
from orbitfb.diagnose.scan import Scanner
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind
from orbitfb.records.layout import Layout

_SURE_NOISE = 10.0
"""Weight of a noise that is there for sure [nats]."""
REFITTED = 6
"""Finalists that are judged again, each under the floor that it leaves itself."""
_TIE = 2.0
"""Within so much of each other [nats] the law with fewer parameters is the answer."""
_SHOWN = 7.0
"""What it says for a cause that the readback of its corrector shows it [nats]: 1000 to 1."""
_GAINS = ("bpm-gain", "corrector-gain")
"""What every device has a little of."""
_LATE = 2
"""Candidates of every kind that are looked for without healthy errors."""
_ABSURD = 1.2
"""Rms of the background's sizes, in units of their scatter, that no healthy ring has."""

Shown = frozenset[tuple[str, int]]
"""Ids of effects, and correctors whose readbacks show them."""


def tournament(
    bench: Bench,
    kinds: Sequence[EffectKind],
    progress: Progress | None = None,
    budget: Budget | None = None,
    shown: Shown = frozenset(),
    least: float = 0.0,
    also: Sequence[Candidate] = (),
) -> list[Entry]:
    """Let every kind compete to explain what a bench leaves.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
        progress: Told what is done and which share of all.
        budget: Time for it; what there was no time for is told to it. None: all there is.
        shown: What the readbacks show.
        least: Weight that a cause needs to be accepted [nats].
        also: Candidates that compete beside those of the scan.

    Returns:
        The entries that were fitted, best first; several places of a kind may be among them.
    """
    tell = progress or (lambda what, share: None)
    budget = budget or Budget(np.inf)
    # What noise is worth is the scan's word: beside none of the errors that every ring has it would
    # be worth these too.
    random = [kind for kind in kinds if isinstance(kind, NoiseKind | LatentKind)]
    swallowed = [kind for kind in kinds if not isinstance(kind, NoiseKind | LatentKind)]
    seen = random
    if np.sum(bench.sizes**2) <= _ABSURD**2 * len(bench.sizes):
        seen = kinds
        # What has no size is never small: healthy errors hide it even if they stay healthy.
        swallowed = [] if bench.causes else [kind for kind in kinds if not kind.parameters]
    proposals = propose(bench, seen, lambda what, share: tell(what, 0.4 * share), budget)
    late: list[EffectKind] = []
    if seen is kinds:  # else all are looked for without healthy errors anyway
        begins = [kind for kind in kinds if kind.sudden]
        late = [kind for kind in begins if kind.stage == "optics" or kind.id in _GAINS]
    if (swallowed or late) and seen is kinds and budget.over(SCAN_SHARE):
        budget.leave("causes that healthy errors may hide were not looked for")
    elif swallowed or late:
        told = bench.floor if bench.told_floor else None
        bare = Bench(bench.record, bench.causes, told, bench.floor.modes, 0.0)
        hidden = list(_begun_late(bare, late))
        if swallowed:
            found = propose(
                bare, swallowed, lambda what, share: tell(what, 0.4 + 0.1 * share), budget
            )
            hidden = [*found, *hidden]
        proposals = _distinct([*hidden, *proposals])
    if also:
        proposals = sorted(_distinct([*also, *proposals]), key=net, reverse=True)
    entries: list[Entry] = []
    for index, candidate in enumerate(proposals):
        tell("fitting", 0.5 + 0.3 * index / len(proposals))
        best = max((least, *(entry.weight for entry in entries)))
        # What has no size is fitted at no cost, and scanned badly: it is never small. How well a
        # noise explains the record is known, whatever it is worth beside healthy ones.
        promise = max(net(candidate), candidate.alone or 0.0)
        if promise > HOPELESS * best or not candidate.cause.kind.parameters:
            if (
                index
                and budget.over()
                and not isinstance(candidate.cause.kind, NoiseKind | LatentKind)
            ):
                budget.untried.append(candidate)
            else:
                entries.append(enter(bench, candidate))
    if not budget.over():
        entries += [enter(bench, candidate) for candidate in other_laws(bench, entries, kinds)]
        entries += [enter(bench, candidate) for candidate in around(bench, entries)]
    entries.sort(key=lambda entry: entry.worth, reverse=True)
    again: list[tuple[Entry, float]] = []
    for entry in entries[:REFITTED]:
        if budget.over():
            budget.leave("the floor of the noise was not estimated anew for every candidate")
            again.append((entry, 0.0))
        else:
            again.append(profiled(bench, entry, entries[0].worth))
    tell("fitting", 1.0)
    # What the floor of the best is worth without any cause is nobody's gain.
    _, owed = max(again, key=lambda one: one[0].worth, default=(None, 0.0))
    rest = [entry.less(owed) for entry in entries[REFITTED:]]
    layout = bench.record.layout
    judged = limits(alike_alike([entry.less(owed) for entry, _ in again], layout))
    return _ranked((*judged, *rest), layout, shown)


def _begun_late(bare: Bench, kinds: Sequence[EffectKind]) -> Iterator[Candidate]:
    """Propose what begins in the record and is like errors that every ring has always had.

    These take half of it, at every steering of the orbit, and hide what a scan would see.

    Args:
        bare: The record under the causes so far, without healthy errors.
        kinds: Of the optics, and gains, that may begin suddenly.
    """
    scanner = Scanner(bare)
    for kind in kinds:
        found = scanner.candidates(kind)
        yield from [one for one in found if one.cause.onset >= 2 * FIRST_ONSET][:_LATE]


def _ranked(every: Sequence[Entry], layout: Layout, shown: Shown) -> list[Entry]:
    """Sort by rank; nothing weighs more than the first one less the difference of their ranks.

    Of laws of the same devices that the record puts as high, the simplest comes first; of those
    that are as simple, one whose values are known. The others amount to it.
    """
    ranks = [_rank(entry, every) + _evidence(entry, shown) for entry in every]
    order = sorted(range(len(every)), key=lambda index: (-ranks[index], every[index].limit_of))
    if not order:
        return []
    top = every[order[0]]
    ties = [
        index
        for index in order
        if ranks[order[0]] - ranks[index] < _TIE and _same_devices(every[index], top, layout)
    ]
    simplest = min(ties, key=lambda index: _plainness(every[index]))
    first = every[simplest]
    ranked = [first]
    for index in order:
        entry = every[index]
        if index != simplest:
            if index in ties and not entry.limit_of and _plainness(entry) > _plainness(first):
                entry = replace(entry, limit_of=first.kind.id)
            weight = first.weight + min(ranks[index] - ranks[simplest], 0.0)
            ranked.append(replace(entry, weight=min(entry.worth, weight)))
    return ranked


def _plainness(entry: Entry) -> tuple[int, bool]:
    """Key that sorts laws, the plainest first."""
    return entry.size, says_little(entry)


def _same_devices(entry: Entry, first: Entry, layout: Layout) -> bool:
    """Whether it is the first one, or another law of the same devices."""
    if entry.fit is None or first.fit is None:
        return entry is first
    return devices(entry.cause, layout) == devices(first.cause, layout)


def _evidence(entry: Entry, shown: Shown) -> float:
    """What the readbacks say for an entry [nats]."""
    told = len(entry.cause.places) == 1 and (entry.kind.id, entry.cause.places[0]) in shown
    return _SHOWN if told else 0.0


def _rank(entry: Entry, every: Sequence[Entry]) -> float:
    """Weight among the others: noise that healthy devices would not have comes before causes.

    How sure a noise is depends on how much healthy devices scatter; how well it explains the
    record does not, and what it leaves in the innovations looks like many other causes. But what
    the readings of the same BPM (not of all of them) do in time is no noise.
    """
    if entry.candidate.alone is None or entry.weight <= _SURE_NOISE:
        return entry.worth
    if entry.candidate.group != "all" and any(
        isinstance(other.kind, SensorKind)
        and other.candidate.alone is None
        and other.cause.places == entry.cause.places
        and other.worth > entry.weight
        for other in every
    ):
        return entry.weight
    return entry.weight + entry.candidate.alone - entry.candidate.gain


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Leave out what was proposed twice."""
    kept: dict[tuple[str, tuple[int, ...], bool, bool], Candidate] = {}
    for candidate in candidates:
        cause = candidate.cause
        kept.setdefault((cause.kind.id, cause.places, cause.onset > 0, cause.free), candidate)
    return list(kept.values())

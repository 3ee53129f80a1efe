"""The tournament: every kind of effect, at every place, against every other and against none.

Each kind proposes its best candidates (scan); the best of all are fitted exactly; each has an
evidence: what the likelihood gains, over the scatter of its scores beyond the noise model, less
what the choice of values, place, onset and kind costs. Nothing here is calibrated on a library of
cases: a candidate that is wrong leaves scores that scatter more than they should, and pays.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.budget import SCAN_SHARE, Budget
from orbitfb.diagnose.candidate import FIRST_ONSET, LAST_ONSET, Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.progress import Progress
from orbitfb.diagnose.randomness import level_candidates, noise_candidates
from orbitfb.diagnose.scan import Scanner
from orbitfb.diagnose.strike_scan import latent_candidates
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

FINALISTS = 10
"""Candidates that are fitted exactly, beside those without a size."""
_KINDS = 7
"""Kinds of which at least the best one is."""
_LEAST_FINALISTS = 3
_SURE_NOISE = 10.0
"""Weight of a noise that is there for sure [nats]."""
_HOPELESS = 0.25
"""Share of the best weight so far that a candidate has to promise to be fitted."""
REFITTED = 6
"""Of them, those that are judged again, each under the floor that it leaves itself."""
_ABSURD = 1.2
"""Rms of the background's sizes, in units of their scatter, that no healthy ring has."""
_ONSET_WORTH = 4.0
"""Rows before an onset must speak against the effect by this much [nats]."""

_THROWN_OFF = 1000.0
"""Weight of a cause beyond which orbit and healthy errors are wrong without it [nats]."""
_STRIDES = (16, 8, 4, 2, 1, 1)
"""Rows by which a beginning is moved, one after the other."""
_SAME = 0.02
"""Two fits leave the same when what they leave differs by less than this share of the gain."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A candidate and what it is worth.

    Args:
        candidate: As proposed.
        fit: As fitted; None for an effect without a course in time, whose gain is that of the
            scan.
        weight: Log of posterior over prior odds against "no effect", per kind [nats].
    """

    candidate: Candidate
    fit: Fit | None
    weight: float

    @property
    def cause(self) -> Cause:
        """With its best values."""
        return self.candidate.cause if self.fit is None else self.fit.causes[0]

    @property
    def kind(self) -> EffectKind:
        """What it is."""
        return self.candidate.cause.kind

    @property
    def gain(self) -> float:
        """Gain of the log-likelihood with its best values [nats]."""
        return self.candidate.gain if self.fit is None else self.fit.gain

    @property
    def held_out(self) -> float:
        """Gain on ticks that were not used for its values [nats]."""
        return self.candidate.gain if self.fit is None else self.fit.held_out


def tournament(
    bench: Bench,
    kinds: Sequence[EffectKind],
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> list[Entry]:
    """Let every kind compete to explain what a bench leaves.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
        progress: Told what is done and which share of all.
        budget: Time for it; what there was no time for is told to it. None: all there is.

    Returns:
        The entries that were fitted, best first; several places of a kind may be among them.
    """
    tell = progress or (lambda what, share: None)
    budget = budget or Budget(np.inf)
    proposals = propose(bench, kinds, lambda what, share: tell(what, 0.5 * share), budget)
    swallowed = kinds
    if np.sum(bench.sizes**2) <= _ABSURD**2 * len(bench.sizes):
        # What has no size is never small: healthy errors hide it even if they stay healthy.
        swallowed = [] if bench.causes else [kind for kind in kinds if not kind.parameters]
    if swallowed and budget.over(SCAN_SHARE):
        budget.leave("causes that healthy errors may hide were not looked for")
    elif swallowed:
        told = bench.floor if bench.told_floor else None
        bare = Bench(bench.record, bench.causes, told, bench.floor.modes, 0.0)
        proposals = _distinct([*propose(bare, swallowed), *proposals])
    entries: list[Entry] = []
    for index, candidate in enumerate(proposals):
        tell("fitting", 0.5 + 0.3 * index / len(proposals))
        best = max((entry.weight for entry in entries), default=0.0)
        # What has no size is fitted at no cost, and scanned badly: it is never small.
        if _net(candidate) > _HOPELESS * best or not candidate.cause.kind.parameters:
            if (
                index
                and budget.over()
                and not isinstance(candidate.cause.kind, NoiseKind | LatentKind)
            ):
                budget.untried.append(candidate)
            else:
                entries.append(_enter(bench, candidate))
    entries.sort(key=lambda entry: entry.weight, reverse=True)
    again: list[Entry] = []
    for entry in entries[:REFITTED]:
        if budget.over():
            budget.leave("the floor of the noise was not estimated anew for every candidate")
            again.append(entry)
        else:
            again.append(_profiled(bench, entry, entries[0].weight))
    tell("fitting", 1.0)
    again = _alike_alike(again)
    return sorted((*again, *entries[REFITTED:]), key=_rank, reverse=True)


def _rank(entry: Entry) -> float:
    """Weight among the others: noise that healthy devices would not have comes before causes.

    How sure a noise is depends on how much healthy devices scatter; how well it explains the
    record does not, and what it leaves in the innovations looks like many other causes.
    """
    spare = 0.0 if entry.candidate.alone is None else entry.candidate.alone - entry.candidate.gain
    return entry.weight + (spare if entry.weight > _SURE_NOISE else 0.0)


def _distinct(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Leave out what was proposed twice."""
    kept: dict[tuple[str, tuple[int, ...], bool], Candidate] = {}
    for candidate in candidates:
        cause = candidate.cause
        kept.setdefault((cause.kind.id, cause.places, cause.onset > 0), candidate)
    return list(kept.values())


def propose(
    bench: Bench,
    kinds: Sequence[EffectKind],
    progress: Progress | None = None,
    budget: Budget | None = None,
) -> list[Candidate]:
    """List the candidates that deserve a fit, best first.

    Args:
        bench: The record under the causes accepted so far.
        kinds: Those that the record can show.
        progress: Told what is done and which share of all.
        budget: Time for it; kinds that are not reached are told to it. None: all there is.
    """
    scanner = Scanner(bench)
    found: list[Candidate] = []
    for index, kind in enumerate(kinds):
        if budget is not None and budget.over(SCAN_SHARE) and not bench.causes:
            budget.unseen += [kind.id] if kind.id not in budget.unseen else []
            continue
        if budget is not None and budget.over():
            budget.leave("further causes were looked for among some effects only")
            break
        if isinstance(kind, NoiseKind):
            found += noise_candidates(bench, kind)
            found += level_candidates(bench, kind)
        elif isinstance(kind, LatentKind):
            found += latent_candidates(bench, kind)
        else:
            found += scanner.candidates(kind)
        if progress is not None:
            progress(kind.id, (index + 1) / len(kinds))
    found += [*_scaled_noise(found, kinds)]
    found.sort(key=_net, reverse=True)
    worth = sum(_net(candidate) > 0.0 for candidate in found)
    return _chosen(found[: max(worth, _LEAST_FINALISTS)])


def _scaled_noise(found: Sequence[Candidate], kinds: Sequence[EffectKind]) -> Iterator[Candidate]:
    """Try what scales readings, noise and all, wherever the noise has another level.

    Where the orbit hardly moves the noise alone shows it: only the fit tells the two apart.
    """
    for kind in kinds:
        if isinstance(kind, SensorKind) and kind.scales and kind.linear is not None:
            for one in found:
                if one.cause.kind.id == "noise-level" and one.cause.places:
                    size = one.cause.values["factor"] - 1.0
                    cause = replace(one.cause, kind=kind, values={kind.linear: size})
                    yield replace(one, cause=cause)


def _chosen(found: Sequence[Candidate]) -> list[Candidate]:
    """Take the best of the best kinds, every one without a size, and the best of the rest."""
    firsts: dict[str, Candidate] = {}
    for candidate in found:
        firsts.setdefault(candidate.cause.kind.id, candidate)
    kept = [*firsts.values()][:_KINDS]
    kept += [one for one in firsts.values() if not one.cause.kind.parameters and one not in kept]
    kept += [one for one in found if one not in kept][: max(FINALISTS - len(kept), 0)]
    return sorted(kept, key=_net, reverse=True)


def _net(candidate: Candidate) -> float:
    return candidate.gain - float(np.log(candidate.choices))


def _enter(bench: Bench, candidate: Candidate) -> Entry:
    kind = candidate.cause.kind
    if isinstance(kind, NoiseKind | LatentKind):
        return Entry(candidate, None, _net(candidate) - len(kind.parameters))
    entry = _begun(bench, _fitted(bench, candidate))
    return max((entry, *_later(bench, entry)), key=lambda one: one.weight)


def _fitted(bench: Bench, candidate: Candidate) -> Entry:
    found = fit(bench, (candidate.cause,))
    return Entry(candidate, found, found.evidence - _price(candidate))


def _price(candidate: Candidate) -> float:
    """What the choice costs, and what of the gain healthy devices may scatter [nats]."""
    spare = 0.0 if candidate.alone is None else candidate.alone - candidate.gain
    return float(np.log(candidate.choices)) + spare


def _begun(bench: Bench, entry: Entry) -> Entry:
    """Look for the row of the beginning that explains the record best, near the one proposed."""
    cause = entry.cause
    if not cause.onset or entry.weight < 0.0:
        return entry
    row, rows = cause.onset, len(bench.record)
    best = log_likelihood(*bench.roughly((cause,)))
    for step in _STRIDES:
        for there in (row - step, row + step):
            if FIRST_ONSET <= there < rows - LAST_ONSET:
                height = log_likelihood(*bench.roughly((replace(cause, onset=there),)))
                if height > best:
                    best, row = height, there
    if row == cause.onset:
        return entry
    moved = replace(entry.candidate, cause=replace(cause, onset=row))
    return max((entry, _fitted(bench, moved)), key=lambda one: one.weight)


def _later(bench: Bench, entry: Entry) -> list[Entry]:
    """Try the same effect from a later row on, if the rows before speak against it."""
    if entry.fit is None or not entry.kind.sudden or entry.cause.onset:
        return []
    course = np.cumsum(entry.fit.gains_by_row)
    row = int(np.argmin(course))
    if course[row] > -_ONSET_WORTH or row + 1 >= len(course):
        return []
    candidate = replace(
        entry.candidate,
        cause=replace(entry.cause, onset=row + 1),
        choices=entry.candidate.choices * len(course),
    )
    return [_fitted(bench, candidate)]


def _alike_alike(entries: Sequence[Entry]) -> list[Entry]:
    """Charge candidates that leave the same the same inflation.

    The mean over the values of a fit falls with every value to which the record is blind, so
    that one that is not needed would pay for itself.
    """
    judged: list[Entry] = []
    for entry in entries:
        own = entry.fit
        if own is None:
            judged.append(entry)
            continue
        least = own.inflation
        for other in entries:
            if other.fit is not None and other.fit.white.shape == own.white.shape:
                apart = float(np.sum((other.fit.white - own.white) ** 2))
                if apart < _SAME * own.gain:
                    least = min(least, other.fit.inflation)
        weight = entry.weight + own.gain * (1.0 / least - 1.0 / own.inflation)
        judged.append(replace(entry, fit=replace(own, inflation=least), weight=weight))
    return judged


def _profiled(bench: Bench, entry: Entry, best: float) -> Entry:
    """Judge an entry under the floor that it leaves itself: it had inflated the floor.

    Where the best entry is worth much more has been thrown off than the floor.
    """
    if entry.fit is None or entry.weight < 0.0:
        return entry
    floor = bench.floor_without(entry.fit.causes)
    if best > _THROWN_OFF and entry.weight > _HOPELESS * best:
        own = bench.cleared_of(entry.fit.causes)
    else:
        own = bench.with_floor(floor)
    found = fit(own, entry.fit.causes)
    lost = own.full_log_likelihood - bench.full_log_likelihood  # by the other floor alone
    gain = found.gain + lost
    weight = gain / found.inflation - found.occam - _price(entry.candidate)
    if weight <= entry.weight:
        return entry
    judged = replace(
        found,
        gain=gain,
        held_out=found.held_out + lost,
        held_out_by_row=found.held_out_by_row + lost / len(found.held_out_by_row),
    )
    return Entry(entry.candidate, judged, weight)

"""What enters the tournament: a candidate, fitted exactly, with the evidence for it."""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.bystanders import (
    GAP,
    with_neighbour,
    without_bystander,
    without_gaps,
    without_idle,
)
from orbitfb.diagnose.candidate import FIRST_ONSET, LAST_ONSET, Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.fit import Fit, fit
from orbitfb.diagnose.noise_onset import begun_noise
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.random_kinds import LatentKind, NoiseKind

HOPELESS = 0.25
"""Share of the best weight so far that a candidate has to promise to be fitted."""
_ONSET_WORTH = 4.0
"""Rows before an onset must speak against the effect by this much [nats]."""
_THROWN_OFF = 50.0
"""Weight of a cause beyond which orbit and healthy errors are wrong without it [nats]."""
_RIVAL = 0.7
"""Share of the best weight from which a fit is judged again with everything that it puts right."""
_STRIDES = (64, 16, 4, 1)
"""Rows by which a beginning is moved, one after the other."""
_TIMES = (-3, -2, -1, 1, 2, 3)
"""How many strides: between two steps of the orbit nothing tells rows apart."""
_WORTH_MORE = 2.0
"""What a fuller law must gain beyond the simpler one [nats]."""


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A candidate and what it is worth.

    Args:
        candidate: As proposed.
        fit: As fitted; None for an effect without a course in time, whose gain is that of the
            scan.
        weight: Log of posterior over prior odds against "no effect", per kind [nats].
        limit_of: Id of the simpler effect that it amounts to in this record; empty if it is a
            law of its own.
        granted: What free levels of noise gain without it beyond what they do with it, which is not
            in its weight [nats]: among others it is worth so much more.
    """

    candidate: Candidate
    fit: Fit | None
    weight: float
    limit_of: str = ""
    granted: float = 0.0

    @property
    def cause(self) -> Cause:
        """With its best values."""
        return self.candidate.cause if self.fit is None else self.fit.causes[0]

    @property
    def kind(self) -> EffectKind:
        """What it is."""
        return self.candidate.cause.kind

    @property
    def size(self) -> int:
        """Number of values that its law needs here."""
        return len(self.kind.parameters) if self.fit is None else self.fit.told

    @property
    def gain(self) -> float:
        """Gain of the log-likelihood with its best values [nats]."""
        return self.candidate.gain if self.fit is None else self.fit.gain

    @property
    def worth(self) -> float:
        """Weight among others, which are not charged with what is free beside it [nats]."""
        return self.weight + self.granted

    def less(self, nats: float) -> "Entry":
        """The same beside a record that is likelier without it [nats]."""
        own = self.fit
        if own is None:
            return replace(self, weight=self.weight - nats)
        fewer = replace(
            own,
            gain=own.gain - nats,
            held_out=own.held_out - nats,
            held_out_by_row=own.held_out_by_row - nats / len(own.held_out_by_row),
        )
        return replace(self, fit=fewer, weight=self.weight - nats / own.inflation)

    @property
    def held_out(self) -> float:
        """Gain on ticks that were not used for its values [nats]."""
        return self.candidate.gain if self.fit is None else self.fit.held_out


def net(candidate: Candidate) -> float:
    """Give what the scan promises, less the cost of the choice [nats]."""
    return candidate.gain - float(np.log(candidate.choices))


def enter(bench: Bench, candidate: Candidate) -> Entry:
    """Fit a candidate, from the beginning on that explains the record best."""
    kind = candidate.cause.kind
    if isinstance(kind, NoiseKind | LatentKind):
        begun = begun_noise(bench, candidate)
        return Entry(begun, None, net(begun) - len(kind.parameters))
    entry = _begun(bench, _fitted(bench, candidate))
    fewer = without_idle(bench, candidate, entry.cause)
    if fewer is not None:
        least = _fitted(bench, fewer)
        entry = least if least.worth > entry.worth - GAP else entry
    joined = _joined(bench, _struck(bench, entry))
    entry = joined if joined.cause.places == entry.cause.places else _begun(bench, joined)
    entry = max((entry, *_later(bench, entry)), key=lambda one: one.worth)
    return _fuller(bench, entry)


def _fitted(bench: Bench, candidate: Candidate) -> Entry:
    least = price(candidate)
    found = fit(bench, (candidate.cause,), least=least)
    return _weighed(bench, candidate, found)


def _weighed(bench: Bench, candidate: Candidate, found: Fit) -> Entry:
    granted = bench.granted(found.causes, found.white) / found.inflation
    return Entry(candidate, found, found.evidence - price(candidate), granted=granted)


def refitted(bench: Bench, entry: Entry) -> Entry:
    """Fit a cause with a course in time on another bench, from its values on."""
    return _fitted(bench, replace(entry.candidate, cause=entry.cause))


def price(candidate: Candidate) -> float:
    """What the choice costs, and what of the gain healthy devices may scatter [nats]."""
    return float(np.log(candidate.choices)) + candidate.whole - candidate.gain


def _begun(bench: Bench, entry: Entry) -> Entry:
    """Look for the row of the beginning that explains the record best, near the one proposed.

    The healthy errors of the bench are of no use for it: they have taken the effect for themselves.
    """
    cause = entry.cause
    if not cause.onset or entry.gain < price(entry.candidate):
        return entry  # what begins a few rows off scatters as a wrong law does
    row, rows = cause.onset, len(bench.record)
    heights = {row: log_likelihood(*bench.residual((cause,)))}
    for step in _STRIDES:
        edge = True
        while edge:
            middle = row
            for begin in (middle + far * step for far in _TIMES):
                if FIRST_ONSET <= begin < rows - LAST_ONSET and begin not in heights:
                    moved = replace(cause, onset=begin)
                    heights[begin] = log_likelihood(*bench.residual((moved,)))
            row = max(heights, key=lambda begin: heights[begin])
            edge = abs(row - middle) >= _TIMES[-1] * step
    if row == cause.onset:
        return entry
    elsewhere = replace(entry.candidate, cause=replace(cause, onset=row))
    return max((entry, _fitted(bench, elsewhere)), key=lambda one: one.worth)


def _struck(bench: Bench, entry: Entry) -> Entry:
    """Leave the members out of a group that are not struck, one after the other."""
    while entry.weight > 0.0:
        rest = without_bystander(bench, entry.candidate, entry.cause)
        fewer = entry if rest is None else _fitted(bench, rest)
        if fewer.worth <= entry.worth:
            break
        entry = fewer
    return entry


def _joined(bench: Bench, entry: Entry) -> Entry:
    """Take neighbours in that are struck too, one after the other, each with a fit of all."""
    best = now = entry
    while now.weight > 0.0 and (more := with_neighbour(bench, now.candidate, now.cause)):
        now = _fitted(bench, more)
        best = max((best, now), key=lambda one: one.worth)
    layout = bench.record.layout
    if best is not entry and (whole := without_gaps(best.candidate, best.cause, layout)):
        filled = _fitted(bench, whole)
        best = filled if filled.worth > best.worth - GAP else best
    return best


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


def _fuller(bench: Bench, entry: Entry) -> Entry:
    """Try the law with its optional parameters, where it is worth something without."""
    record = bench.record
    values = entry.kind.fuller(entry.cause.values, record) if entry.weight > 0.0 else None
    if values is None:
        return entry
    cause = replace(entry.cause, values=values)
    full = _fitted(bench, replace(entry.candidate, cause=cause))
    better = full.gain > entry.gain + _WORTH_MORE and full.worth > entry.worth
    return full if better else entry


def profiled(bench: Bench, entry: Entry, best: float) -> tuple[Entry, float]:
    """Judge an entry under the floor that it leaves itself: it had inflated the floor.

    Where the best entry is worth much more has been thrown off than the floor.

    Returns:
        The entry, and by how much the record is likelier under that floor without it [nats].
    """
    thrown_off = best > _THROWN_OFF
    least = max((_RIVAL if thrown_off else HOPELESS) * best, 0.0)
    if entry.fit is None or entry.weight < least:
        return entry, 0.0
    if thrown_off:
        own = bench.cleared_of(entry.fit.causes)
    else:
        own = bench.with_floor(bench.floor_without(entry.fit.causes))
    found = fit(own, entry.fit.causes)
    alone = own.full_log_likelihood - bench.full_log_likelihood
    judged = _weighed(own, entry.candidate, found)
    # What is free without it is that of the bench, whatever floor the fit has.
    free = judged.granted * found.inflation - entry.granted * entry.fit.inflation
    judged = replace(judged.less(-alone - free), granted=entry.granted)
    if judged.worth <= entry.worth:
        return entry, 0.0
    return judged, float(np.clip(judged.gain - entry.gain, 0.0, max(alone, 0.0)))

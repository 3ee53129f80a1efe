"""What enters the tournament: a candidate, fitted exactly, with the evidence for it."""

from collections.abc import Sequence
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
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import EffectKind
from orbitfb.effects.layout import Layout
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
_FAR = (-3, -2, -1, 1, 2, 3)
"""How often: between two steps of the orbit nothing tells rows apart, and the next may be far."""
_SAME = 0.02
"""Two fits leave the same when what they leave differs by less than this share of the gain."""
_ONE_LAW = 9.0
"""Two fits are one law when what they leave differs by less, summed over all squares of the white
innovations, for every parameter that one has more: three standard deviations of what noise does."""
_AT_MOST = 0.2
"""The same as a share of the gain: the changes they make have a cosine of 0.95."""
_WORTH_MORE = 2.0
"""What a fuller law must gain beyond the simpler one [nats]."""
_UNKNOWN = 10.0
"""Ends of a 90 % interval that are further apart by this factor do not tell a value."""
_NEARLY = 0.8
"""Share of the gain from which another law of the same devices bears witness."""


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
    """

    candidate: Candidate
    fit: Fit | None
    weight: float
    limit_of: str = ""

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
        """Number of values that its law has."""
        return len(self.kind.parameters if self.fit is None else self.fit.parameters)

    @property
    def gain(self) -> float:
        """Gain of the log-likelihood with its best values [nats]."""
        return self.candidate.gain if self.fit is None else self.fit.gain

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
        entry = least if least.weight > entry.weight - GAP else entry
    joined = _joined(bench, _struck(bench, entry))
    entry = joined if joined.cause.places == entry.cause.places else _begun(bench, joined)
    entry = max((entry, *_later(bench, entry)), key=lambda one: one.weight)
    return _fuller(bench, entry)


def _fitted(bench: Bench, candidate: Candidate) -> Entry:
    least = price(candidate)
    found = fit(bench, (candidate.cause,), least=least)
    return Entry(candidate, found, found.evidence - least)


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
            for begin in (middle + far * step for far in _FAR):
                if FIRST_ONSET <= begin < rows - LAST_ONSET and begin not in heights:
                    moved = replace(cause, onset=begin)
                    heights[begin] = log_likelihood(*bench.residual((moved,)))
            row = max(heights, key=lambda begin: heights[begin])
            edge = abs(row - middle) >= _FAR[-1] * step
    if row == cause.onset:
        return entry
    elsewhere = replace(entry.candidate, cause=replace(cause, onset=row))
    return max((entry, _fitted(bench, elsewhere)), key=lambda one: one.weight)


def _struck(bench: Bench, entry: Entry) -> Entry:
    """Leave the members out of a group that are not struck, one after the other."""
    while entry.weight > 0.0:
        rest = without_bystander(bench, entry.candidate, entry.cause)
        fewer = entry if rest is None else _fitted(bench, rest)
        if fewer.weight <= entry.weight:
            break
        entry = fewer
    return entry


def _joined(bench: Bench, entry: Entry) -> Entry:
    """Take neighbours in that are struck too, one after the other, each with a fit of all."""
    best = now = entry
    while now.weight > 0.0 and (more := with_neighbour(bench, now.candidate, now.cause)):
        now = _fitted(bench, more)
        best = max((best, now), key=lambda one: one.weight)
    layout = bench.record.layout
    if best is not entry and (whole := without_gaps(best.candidate, best.cause, layout)):
        filled = _fitted(bench, whole)
        best = filled if filled.weight > best.weight - GAP else best
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


def devices(cause: Cause, layout: Layout) -> tuple[int, ...]:
    """Places of a cause; all correctors, of what acts on their currents in the whole ring."""
    if isinstance(cause.kind, ActuatorKind) and cause.kind.target == "ring":
        return tuple(range(len(layout.correctors)))
    return cause.places


def _fuller(bench: Bench, entry: Entry) -> Entry:
    """Try the law with its optional parameters, where it is worth something without."""
    record = bench.record
    values = entry.kind.fuller(entry.cause.values, record) if entry.weight > 0.0 else None
    if values is None:
        return entry
    cause = replace(entry.cause, values=values)
    full = _fitted(bench, replace(entry.candidate, cause=cause))
    better = full.gain > entry.gain + _WORTH_MORE and full.weight > entry.weight
    return full if better else entry


def alike_alike(entries: Sequence[Entry], layout: Layout) -> list[Entry]:
    """Charge candidates that leave the same the same inflation, and those of the same devices.

    The mean over the values of a fit falls with every value to which the record is blind, so
    that one that is not needed would pay for itself. What the laws of the same devices leave is
    the same surplus; the value of one may move just with it, as a delay does with its jitter.
    """
    judged: list[Entry] = []
    for entry in entries:
        own = entry.fit
        if own is None:
            judged.append(entry)
            continue
        least = own.inflation
        here = devices(entry.cause, layout)
        for other in entries:
            if other.fit is not None and (
                _apart(other.fit, own) < _SAME * own.gain
                or (other.fit.gain > _NEARLY * own.gain and devices(other.cause, layout) == here)
            ):
                least = min(least, other.fit.inflation)
        weight = entry.weight + own.gain * (1.0 / least - 1.0 / own.inflation)
        judged.append(replace(entry, fit=replace(own, inflation=least), weight=weight))
    return judged


def says_little(entry: Entry) -> bool:
    """Whether a value that is fitted by its logarithm is known to no factor.

    A corrector with a time constant far beyond the record is stuck.
    """
    if entry.fit is None:
        return False
    ends = [
        entry.fit.interval(index)
        for index, (_, parameter) in enumerate(entry.fit.parameters)
        if parameter.log
    ]
    return any(high > _UNKNOWN * low for low, high in ends)


def limits(entries: Sequence[Entry]) -> list[Entry]:
    """Mark what is the same law as an effect with fewer parameters, in a limit of its own.

    Within a play that is wider than all it did, a corrector has a gain error. The simpler law is
    the answer; the record does not have to decide between the two.
    """
    marked: list[Entry] = []
    for entry in entries:
        simpler = [
            other
            for other in entries
            if _apart(entry.fit, other.fit)
            < min(_ONE_LAW * max(entry.size - other.size, 0), _AT_MOST * other.gain)
        ]
        law = min(simpler, key=lambda other: other.size, default=None)
        if law is not None:
            worth = min(entry.weight, law.weight)
            entry = replace(entry, limit_of=law.kind.id, weight=worth)
        marked.append(entry)
    return marked


def _apart(one: Fit | None, other: Fit | None) -> float:
    """Sum of the squared differences of what two fits leave; infinite where none can be said."""
    if one is None or other is None or one.white.shape != other.white.shape:
        return np.inf
    return float(np.sum((one.white - other.white) ** 2))


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
    judged = Entry(entry.candidate, found, found.evidence - price(entry.candidate)).less(-alone)
    if judged.weight <= entry.weight:
        return entry, 0.0
    return judged, float(np.clip(judged.gain - entry.gain, 0.0, max(alone, 0.0)))

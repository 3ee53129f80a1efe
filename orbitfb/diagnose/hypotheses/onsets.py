"""Laws that begin in the middle of a record.

They are weighed from every tenth row on, device by device and group by group. From the best row on
their devices are sought as those of a law that was always there, and the best set row by row. Laws
whose course is a constant are in `jumps`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import choices, evaluated, field_of
from orbitfb.diagnose.hypotheses.jumps import of_jumps
from orbitfb.diagnose.hypotheses.ranking import (
    Ranked,
    any_size,
    cost_of,
    scales,
    sign,
    stood_in,
    within,
    worths_of,
)
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms, given_size, normal_size
from orbitfb.estimation.priors import (
    ONSET_MARGIN,
    ONSET_SIGN,
    ONSETS_EVERY,
    SIZE_WIDTH,
    STANDING,
)
from orbitfb.estimation.transform import Indices, Matrix

_HOPEFUL = 24
"""Devices whose onsets are looked for at most, those of which most shows."""

_COLUMNS = 400
"""Courses of single devices that are weighed at once, exactly: as many as healthy errors have."""


@dataclass(frozen=True, slots=True)
class _Begin:
    """Devices that begin late.

    Args:
        evidence: As scanned, less the choice of devices and row.
        places: Numbers of the devices: a single one, a group, or all (empty).
        row: At which they begin.
        values: Of the parameters.
        others: Rows that were scanned, the best first: healthy errors make a law look much the
            same from many of them.
    """

    evidence: float
    places: tuple[int, ...]
    row: int
    values: Values
    others: tuple[int, ...] = ()


def scan_late(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """Find the devices of a law that begin late together with the most evidence.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best ones, if any are worth something.
    """
    if not kind.sudden or law.whole:
        return []
    # Where nothing shows over the whole record a first kick may still tell, or the change of what
    # the healthy error of the same devices stands in for.
    tried = rank.beginning
    if not tried and (law.standing or (kind.linear is not None and scorer.is_usual(kind))):
        tried = list(rank.grid[:1])
    begun = [_begins(kind, law, scorer, values) for values in tried]
    best = max((one for one in begun if one), key=lambda one: one.evidence, default=None)
    if best is None or best.evidence <= 0.0:
        return []
    cost = cost_of(kind, best.values, scorer)
    if law.standing:
        return [_kicking(kind, law, scorer, best, cost)]
    return list(_from(kind, law, scorer, best, cost))


def _begins(kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values) -> _Begin | None:
    """The best device, or group, that begins late; None: nothing is as if one did.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        values: Of the parameters.
    """
    spectra = scorer.space.courses.spectra(law, values)
    if not any(np.any(one) for one in spectra):
        return None
    count = len(law.names)
    error = scorer.own_error(kind)
    pull, information = scorer.apart(law, values, error)
    shown = sign(pull, information)
    kicks = _kicks(law, scorer, spectra) if law.standing else None
    if kicks is not None:
        shown = shown + np.maximum(kicks.max(axis=0) - np.log(len(kicks)), 0.0)
    usual = scorer.is_usual(kind)
    usual = usual or (not scales(kind) and stood_in(kind, law, values, scorer))
    sets = _hopeful_sets(law, scorer, pull, spectra, every=usual)
    if usual:
        hopeful = np.arange(count)
    else:
        hopeful = np.flatnonzero(shown > ONSET_SIGN)
        hopeful = hopeful[np.argsort(-shown[hopeful], kind="stable")[:_HOPEFUL]]
        hopeful = np.unique(np.concatenate([hopeful, *sets]))
    if not len(hopeful):
        return None
    error = scorer.own_error(kind, hopeful)
    steps = [
        np.broadcast_to(turned, (len(turned), count))
        for turned in (scorer.space.transform.turn(one) for one in spectra)
    ]
    onsets = np.arange(0, len(steps[0]), ONSETS_EVERY)
    among = [np.searchsorted(hopeful, its) for its in sets]
    parts = [
        scorer.rows.since(pattern[:, hopeful], own[:, hopeful], onsets, error, among)
        for pattern, own in zip(law.patterns, steps, strict=True)
    ]
    # Of a law of one size, too: healthy errors stand in for a part of what is left of it.
    gain = any_size(*(np.sum(its, axis=0) for its in zip(*parts, strict=True)))
    if kicks is not None:
        gain = gain + np.maximum.reduceat(kicks[:, hopeful], onsets, axis=0)
    outside = (onsets < ONSET_MARGIN) | (onsets > len(scorer.space.transform) - ONSET_MARGIN)
    gain[outside] = -np.inf
    onset, place = map(int, np.unravel_index(int(np.argmax(gain)), gain.shape))
    single = place < len(hopeful)
    places = hopeful[place : place + 1] if single else sets[place - len(hopeful)]
    cost = np.log(count + len(law.groups)) + np.log(len(onsets))
    row = int(onsets[onset])
    if kicks is not None:  # the kick tells the row
        row += int(np.argmax(kicks[row : row + ONSETS_EVERY, hopeful[place]]))
    rows = scorer.space.transform.step_rows()
    told = tuple(map(int, places)) if single or len(places) < count else ()
    order = onsets[np.argsort(-gain[:, place], kind="stable")]
    others = tuple(int(one) for one in rows[order] if np.isfinite(gain[one // ONSETS_EVERY, place]))
    return _Begin(float(gain[onset, place] - cost), told, int(rows[row]), values, others)


def _kicks(law: DeviceLaw, scorer: Scorer, spectra: Sequence[Single]) -> Matrix:
    """Log evidence of a first kick of any size of every device at every step, shape (T, D)."""
    total: Matrix | float = 0.0
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        pull, own = of_jumps(pattern, scorer)
        variance = _standing(spectrum) ** 2
        total = total + normal_size(pull, np.broadcast_to(own, pull.shape), variance)
    return np.asarray(total)


def _standing(spectrum: Single) -> Vector:
    """Size that a first kick may have, in the units of a course, (D,) or (1,) of (T, D or 1)."""
    return STANDING * np.sqrt(np.mean(spectrum.astype(np.float64) ** 2, axis=0))


def _from(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, begin: _Begin, cost: float
) -> Iterator[Candidate]:
    """The devices that begin at a row: those that were scanned, and the best set of all."""
    signals, values = scorer.space.signals, begin.values
    courses = Course(law, (), values, np.ones(len(law.names)), begin.row).of(signals, values)
    spectra = [scorer.space.transform.quick_spectrum(one) for one in courses]
    pull, information = scorer.score(law.patterns, spectra)
    information = scorer.marginal(kind, law.patterns, spectra, information)
    late = float(np.log(scorer.space.transform.rows))
    for worth, free in worths_of(kind):
        # One that has no size is sought of any: healthy errors stand in for a part of it.
        its = worth if scales(kind) else any_size
        gain, places = best_set(pull, information, law.groups, its, alone=not kind.collective)
        names = tuple(law.names[place] for place in places)
        yield Candidate(
            kind, places, names, values, gain - cost - late, onset=begin.row,
            finer=partial(_exactly, kind, law, scorer, replace(begin, places=places), cost, free),
        )  # fmt: skip


def _exactly(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, begin: _Begin, cost: float, free: bool
) -> Candidate:
    """A set that begins late, with and without what its beginning kicks, row by row.

    The row is told by at most `_HOPEFUL` of its devices: first among those that were scanned, then
    around the best of them; and again over a floor that was estimated with it.
    """
    places, values = begin.places, begin.values
    devices = (places or tuple(range(len(law.names))))[:_HOPEFUL]
    worth, last = any_size if free else given_size, scorer.space.transform.rows - 2
    best, tried = (-np.inf, begin.row, False), begin.others[: _COLUMNS // len(devices)]
    for _ in range(2):
        for kick in (False, True):
            gain = worth(*_by_row(law, scorer, values, devices, tried, kick))
            place = int(np.argmax(gain))
            best = max(best, (float(gain[place]), tried[place], kick))
        near = range(best[1] - 2 * ONSETS_EVERY, best[1] + 2 * ONSETS_EVERY)
        tried = tuple(one for one in near if 0 < one < last)
    _, row, kick = best

    def again(after: Workspace) -> Candidate:
        return _exactly(kind, law, Scorer.of(over(scorer.space, after)), begin, cost, free)

    found = evaluated(kind, law, scorer, places, values, row, free, cost, kick)
    found = replace(found, again=again)
    if not (free and 0 < len(places) <= _HOPEFUL):
        return found
    # What stands in a device before it begins is in no record: it may kick by any of it.
    kicked = _kicking(kind, law, scorer, replace(begin, row=row), cost)
    return max(found, kicked, key=lambda one: one.evidence)


def _by_row(
    law: DeviceLaw,
    scorer: Scorer,
    values: Values,
    devices: Sequence[int],
    rows: Sequence[int],
    kick: bool,
) -> tuple[Vector, Vector]:
    """Pull and information of devices that begin together at a row, exactly, for every row."""
    patterns, begun = [], []
    for pattern, course in zip(law.patterns, law.course(values, scorer.space.signals), strict=True):
        for device in devices:
            own = course[:, 0] if course.shape[1] == 1 else course[:, device]
            patterns.append(np.repeat(pattern[:, [device]], len(rows), axis=1))
            begun.append(np.stack([_begun(own, row, kick) for row in rows], axis=1))
    spectrum = scorer.space.transform.quick_spectrum(np.hstack(begun))
    pull, information = scorer.columns(patterns, spectrum)
    return pull, np.diag(information)


def _hopeful_sets(
    law: DeviceLaw, scorer: Scorer, pull: Vector, spectra: Sequence[Single], every: bool
) -> list[Indices]:
    """Groups of devices, and all of them, that may begin late together.

    Args:
        law: Of the devices.
        scorer: Of what is left to explain.
        pull: Of every device over the whole record, shape (D,).
        spectra: Of its courses.
        every: Whether to take all, whatever they show over the whole record.
    """
    count = len(law.names)
    groups = [] if law.standing else [one for one in law.groups.values() if 1 < len(one) < count]
    if not groups:
        return []
    seen = [
        scorer.together(block, spectrum, groups)
        for block, spectrum in zip(law.patterns, spectra, strict=True)
    ]
    information = np.array([[*parts, one] for one, parts in seen]).sum(axis=0)
    sets = [*groups, np.arange(count)]
    total = np.array([pull[one].sum() for one in sets])
    shown = sign(total, information)
    return [np.sort(one) for one, its in zip(sets, shown, strict=True) if every or its > ONSET_SIGN]


def _kicking(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    begin: _Begin,
    cost: float,
) -> Candidate:
    """Devices that begin late, each kicking by an orbit that stands in it, plane by plane."""
    places, onset, values = begin.places, begin.row, begin.values
    space = scorer.space
    source = Course(law, places, values, np.ones(len(places)), onset)
    courses = source.of(space.signals, values)
    fields = [field_of(law, scorer, courses, source.places, source.size)]
    jump = (np.arange(space.transform.rows) >= onset).astype(float)[:, None]
    spectrum = space.transform.quick_spectrum(jump)
    whole = law.course(values, space.signals)
    for device in places:
        for pattern, course in zip(law.patterns, whole, strict=True):
            own = course if course.shape[1] == 1 else course[:, [device]]
            size = _standing(space.transform.quick_spectrum(own))
            fields.append(spectrum @ (size * pattern[:, [device]]).T.astype(np.float32))
    pull, information = scorer.evaluate(fields)
    variance = np.array([SIZE_WIDTH**2, *np.ones(len(fields) - 1)])
    terms = NormalTerms(pull, information, variance)
    sizes = terms.held(within(kind, values, float(terms.mean()[0])))
    size = float(sizes[0])
    added = sum(k * one for k, one in zip(sizes, fields, strict=True))
    gain = terms.evidence_at(sizes) - cost - choices(law, places) - np.log(space.transform.rows)
    scaled = {**values, **{one.name: size * values[one.name] for one in kind.sizes}}
    return Candidate(
        kind, places, tuple(law.names[one] for one in places), scaled, float(gain), onset=onset,
        field=np.asarray(added, dtype=float), sources=(replace(source, size=size * source.size),),
    )  # fmt: skip


def _begun(course: Vector, onset: int, kick: bool) -> Vector:
    """A course that begins at a row, with or without what it has reached by then."""
    base = course[0] if kick else course[onset]
    return np.where(np.arange(len(course)) < onset, 0.0, course - base)

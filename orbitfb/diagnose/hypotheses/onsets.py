"""Laws that begin in the middle of a record.

Of a law whose course is a constant the row at which it begins is all that shows. Others are weighed
from every tenth row on, device by device, and the best of them row by row.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.device_laws import choices, evaluated, field_of
from orbitfb.diagnose.hypotheses.ranking import Ranked, any_size, scales, within
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw
from orbitfb.estimation.evidence import NormalTerms, best_size, given_size, normal_size
from orbitfb.estimation.priors import (
    ONSET_MARGIN,
    ONSET_SIGN,
    ONSETS_EVERY,
    SIZE_WIDTH,
    STANDING,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix

_HOPEFUL = 24
"""Devices whose onsets are looked for at most, those of which most shows."""

_ROUNDING = 1e-6
"""Relative change of a course that is rounding [1]: a jump of 5 µm on an orbit of millimetres is
right to a hundredth of that."""


def jumps_of(law: DeviceLaw | FieldLaw, values: Values, scorer: Scorer) -> Matrix | None:
    """Change of the readings where a law begins, of every place, shape (n, D) [m].

    None of a law whose courses change within the record, and of one that does nothing.
    """
    courses = law.course(values, scorer.space.signals)
    parts = courses if isinstance(courses, tuple) else (courses,)
    constant = all(np.allclose(one, one[:1], rtol=_ROUNDING, atol=0.0) for one in parts)
    if not constant or not any(np.any(one) for one in parts):
        return None
    if isinstance(law, FieldLaw):
        return parts[0][:1].T
    return np.asarray(sum(one[0] * block for one, block in zip(parts, law.patterns, strict=True)))


def scan_jumps(
    kind: EffectKind,
    patterns: Matrix,
    names: tuple[str, ...],
    values: Values,
    scorer: Scorer,
) -> list[Candidate]:
    """Find the place and the row of the most telling jump.

    Args:
        kind: The effect.
        patterns: Change of the readings by a jump of the usual size, shape (n, D) [m].
        names: Of the places; none: the ring.
        values: Of its parameters, of the usual size.
        scorer: Of what is left to explain.
    """
    space = scorer.space
    pull, own = _of_jumps(patterns, scorer)
    gain = any_size(pull, np.broadcast_to(own, pull.shape))
    step, place = map(int, np.unravel_index(int(np.argmax(gain)), gain.shape))
    row = int(space.transform.step_rows()[step])
    jump = (np.arange(space.transform.rows) >= row).astype(float)[:, None]
    field = space.transform.spectrum(jump) @ patterns[:, place : place + 1].T
    pulled, information = scorer.evaluate([field])
    size = float(best_size(pulled, information[0], SIZE_WIDTH**2)[0])
    evidence = float(any_size(pulled, information[0])[0])
    evidence -= float(np.log(gain.size)) + VALUE_COST
    scaled = {**values, **{p.name: size * values[p.name] for p in kind.sizes}}
    where = (place,) if names else ()
    told = tuple(names[one] for one in where)
    return [Candidate(kind, where, told, scaled, evidence, onset=row, field=size * field)]


@dataclass(frozen=True, slots=True)
class _Begin:
    """A device that begins late.

    Args:
        evidence: As scanned, less the choice of device and row.
        device: Its number.
        row: At which it begins.
        values: Of the parameters.
    """

    evidence: float
    device: int
    row: int
    values: Values


def scan_late(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """Find the single device of a law that begins late with the most evidence.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best one, if any is worth something.
    """
    if not kind.sudden or law.whole:
        return []
    # Where nothing shows over the whole record a first kick may still tell.
    tried = rank.promising or (list(rank.grid[:1]) if law.standing else [])
    begun = [_begins(kind, law, scorer, values) for values in tried]
    best = max((one for one in begun if one), key=lambda one: one.evidence, default=None)
    if best is None or best.evidence <= 0.0:
        return []
    cost = VALUE_COST * len(kind.parameters)
    evaluate = _kicking if law.standing else _from
    return [evaluate(kind, law, scorer, best, cost)]


def _begins(kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values) -> _Begin | None:
    """The best single device that begins late; None: nothing is as if one did.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        values: Of the parameters.
    """
    spectra = scorer.space.courses.spectra(law, values)
    if not any(np.any(one) for one in spectra):
        return None
    error = scorer.own_error(kind, np.arange(len(law.names)))
    pull, information = scorer.apart(law, values, error)
    sign = pull**2 / (2.0 * np.maximum(information, 1e-300))
    kicks = _kicks(law, scorer, spectra) if law.standing else None
    if kicks is not None:
        sign = sign + np.maximum(kicks.max(axis=0) - np.log(len(kicks)), 0.0)
    hopeful = np.flatnonzero(sign > ONSET_SIGN)
    if not len(hopeful):
        return None
    hopeful = hopeful[np.argsort(-sign[hopeful])[:_HOPEFUL]]
    error = scorer.own_error(kind, hopeful)
    total_pull: Matrix | float = 0.0
    total_information: Matrix | float = 0.0
    onsets = np.zeros(0, dtype=np.intp)
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        columns = spectrum if spectrum.shape[1] == 1 else spectrum[:, hopeful]
        steps = scorer.space.transform.turn(columns)
        part, weight, onsets = scorer.rows.since(
            pattern[:, hopeful],
            np.broadcast_to(steps, (len(steps), len(hopeful))),
            ONSETS_EVERY,
            error,
        )
        total_pull, total_information = total_pull + part, total_information + weight
    free = scales(kind)
    worth = any_size if free else given_size
    gain = worth(np.asarray(total_pull), np.asarray(total_information))
    if kicks is not None:
        gain += np.maximum.reduceat(kicks[:, hopeful], onsets, axis=0)
    outside = (onsets < ONSET_MARGIN) | (onsets > len(scorer.space.transform) - ONSET_MARGIN)
    gain[outside] = -np.inf
    onset, device = np.unravel_index(int(np.argmax(gain)), gain.shape)
    cost = np.log(len(sign)) + np.log(len(onsets))
    row = int(onsets[onset])
    if kicks is not None:  # the kick tells the row
        row += int(np.argmax(kicks[row : row + ONSETS_EVERY, hopeful[device]]))
    rows = scorer.space.transform.step_rows()
    return _Begin(float(gain[onset, device] - cost), int(hopeful[device]), int(rows[row]), values)


def _kicks(law: DeviceLaw, scorer: Scorer, spectra: Sequence[Single]) -> Matrix:
    """Log evidence of a first kick of any size of every device at every step, shape (T, D)."""
    total: Matrix | float = 0.0
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        pull, own = _of_jumps(pattern, scorer)
        variance = _standing(spectrum) ** 2
        total = total + normal_size(pull, np.broadcast_to(own, pull.shape), variance)
    return np.asarray(total)


def _of_jumps(patterns: Matrix, scorer: Scorer) -> tuple[Matrix, Vector]:
    """Pull (T, D) and information (D,) of a jump along each of D patterns at every step."""
    noise, transform = scorer.space.noise, scorer.space.transform
    weight = np.mean(1.0 / noise.variance(transform), axis=0)
    return scorer.rows.late @ patterns, ((patterns.T @ noise.modes) ** 2) @ weight


def _standing(spectrum: Single) -> Vector:
    """Size that a first kick may have, in the units of a course, (D,) or (1,) of (T, D or 1)."""
    return STANDING * np.sqrt(np.mean(spectrum.astype(np.float64) ** 2, axis=0))


def _from(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    begin: _Begin,
    cost: float,
) -> Candidate:
    """The finalist that begins late, with and without what its beginning kicks, row by row."""
    device, onset, values = begin.device, begin.row, begin.values
    free = scales(kind)
    courses = law.course(values, scorer.space.signals)
    last = scorer.space.transform.rows - 2
    tried = np.arange(max(onset - 2 * ONSETS_EVERY, 1), min(onset + 2 * ONSETS_EVERY, last))
    worth = any_size if free else given_size
    error = scorer.own_error(kind, np.array([device]))
    best: tuple[float, int, bool] = (-np.inf, onset, False)
    for kick in (False, True):
        pull: Vector | float = 0.0
        information: Vector | float = 0.0
        for pattern, course in zip(law.patterns, courses, strict=True):
            own = course[:, 0] if course.shape[1] == 1 else course[:, device]
            begun = np.stack([_begun(own, int(row), kick) for row in tried], axis=1)
            part, weight = scorer.rows.quick(pattern[:, device], begun, error)
            pull, information = pull + part, information + weight
        gain = worth(np.asarray(pull), np.asarray(information))
        place = int(np.argmax(gain))
        best = max(best, (float(gain[place]), int(tried[place]), kick))
    _, row, kick = best
    return evaluated(kind, law, scorer, (device,), values, row, free, cost, kick)


def _kicking(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    begin: _Begin,
    cost: float,
) -> Candidate:
    """A device that begins late, and kicks by an orbit that stands in it, plane by plane."""
    device, onset, values = begin.device, begin.row, begin.values
    space = scorer.space
    source = Course(law, (device,), values, np.ones(1), onset)
    courses = source.of(space.signals, values)
    fields = [field_of(law, scorer, courses, source.places, source.size)]
    jump = (np.arange(space.transform.rows) >= onset).astype(float)[:, None]
    spectrum = space.transform.quick_spectrum(jump)
    whole = law.course(values, space.signals)
    for pattern, course in zip(law.patterns, whole, strict=True):
        own = course if course.shape[1] == 1 else course[:, [device]]
        size = _standing(space.transform.quick_spectrum(own))
        fields.append(spectrum @ (size * pattern[:, [device]]).T.astype(np.float32))
    pull, information = scorer.evaluate(fields)
    variance = np.array([SIZE_WIDTH**2, *np.ones(len(fields) - 1)])
    terms = NormalTerms(pull, information, variance)
    sizes = terms.mean()
    size = within(kind, values, float(sizes[0]))
    added = size * fields[0] + sum(k * one for k, one in zip(sizes[1:], fields[1:], strict=True))
    gain = terms.evidence() - cost - choices(law, (device,)) - np.log(space.transform.rows)
    scaled = {**values, **{one.name: size * values[one.name] for one in kind.sizes}}
    return Candidate(
        kind, (device,), (law.names[device],), scaled, float(gain), onset=onset,
        field=np.asarray(added, dtype=float), sources=(replace(source, size=size * source.size),),
    )  # fmt: skip


def _begun(course: Vector, onset: int, kick: bool) -> Vector:
    """A course that begins at a row, with or without what it has reached by then."""
    base = course[0] if kick else course[onset]
    return np.where(np.arange(len(course)) < onset, 0.0, course - base)

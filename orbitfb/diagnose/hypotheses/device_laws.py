"""Scan a law of devices over its values, its devices and the rows at which it may begin."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import fminbound

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import (
    Ranked,
    any_size,
    any_size_at,
    scales,
    within,
    worths_of,
)
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import NormalTerms, best_size, given_size, normal_size
from orbitfb.estimation.priors import (
    FINENESS,
    GRID_REACH,
    ONSET_MARGIN,
    ONSET_SIGN,
    ONSETS_EVERY,
    SIZE_WIDTH,
    STANDING,
    VALUE_COST,
)
from orbitfb.estimation.transform import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A set with values, as scanned."""

    evidence: float
    places: tuple[int, ...]
    values: Values
    free: bool


def scan_devices(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """Find the best values, devices and onset of one law.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best candidates of all devices and of some of them, and the best that begins later.
    """
    grid = rank.grid
    usual = any(block.kind is kind and not block.accepted for block in scorer.space.blocks)
    cost = VALUE_COST * len(kind.parameters)
    every: list[_Found] = []
    some: list[_Found] = []
    late: tuple[float, int, int, Values] = (-np.inf, 0, 0, grid[0] if grid else {})
    for values in rank.promising:
        spectra = scorer.space.courses.spectra(law, values)
        pull, information = scorer.score(law.patterns, spectra)
        information = scorer.marginal(kind, law.patterns, spectra, information)
        for worth, free in worths_of(kind):
            gain, places = best_set(
                pull, information, law.groups, worth, whole=law.whole, alone=not kind.collective
            )
            (some if places else every).append(_Found(gain, places, values, free))
            if places and kind.collective:
                gain = float(worth(np.array([pull.sum()]), np.array([information.sum()]))[0])
                every.append(_Found(gain, (), values, free))
        if kind.sudden and not law.whole:
            sign = pull**2 / (2.0 * np.maximum(np.diag(information), 1e-300))
            begun = _late(kind, law, scorer, spectra, sign, values)
            late = max(late, begun, key=lambda one: one[0])
    if kind.sudden and law.standing and not rank.promising:  # the first kick may tell of it
        spectra = scorer.space.courses.spectra(law, grid[0])
        late = _late(kind, law, scorer, spectra, np.zeros(len(law.names)), grid[0])
    candidates = []
    for found in (every, some):
        top = max(found, key=lambda one: one.evidence, default=None)
        if top is not None and top.evidence > 0.0 and not usual:
            candidates.append(_refined(kind, law, scorer, grid, top, cost))
    best = 0.0 if usual else max((one.evidence for one in (*every, *some)), default=0.0)
    if late[0] > max(0.0, best):
        candidates += _late_candidates(kind, law, scorer, late, cost)
    return candidates


def _refined(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    grid: Sequence[Values],
    top: _Found,
    cost: float,
) -> Candidate:
    """The best value of the grid, as scanned; it knows how to be exact, and to search between."""

    def exact(values: Values) -> Candidate:
        return _candidate(kind, law, scorer, top.places, values, 0, top.free, cost)

    names = tuple(law.names[place] for place in top.places)
    return Candidate(
        kind, top.places, names, top.values, top.evidence - cost,
        finer=lambda: _finer(exact, top, grid),
    )  # fmt: skip


def _finer(exact: Callable[[Values], Candidate], top: _Found, grid: Sequence[Values]) -> Candidate:
    """Be exact, and search between the neighbours of the best value in the grid."""
    best, name = exact(top.values), _running(grid)
    if name is None or best.evidence <= 0.0:
        return best
    line = sorted({one[name] for one in grid})
    place = line.index(top.values[name])
    low, high = line[max(place - GRID_REACH, 0)], line[min(place + GRID_REACH, len(line) - 1)]
    bend = np.log if low > 0.0 else np.asarray
    back = np.exp if low > 0.0 else np.asarray

    def loss(bent: float) -> float:
        return -exact({**top.values, name: float(back(bent))}).evidence

    span = (float(bend(low)), float(bend(high)))
    fine = FINENESS * (span[1] - span[0])
    bent = float(np.asarray(fminbound(loss, *span, xtol=fine, full_output=False)))
    trial = exact({**top.values, name: float(back(bent))})
    return max(best, trial, key=lambda one: one.evidence)


def _running(grid: Sequence[Values]) -> str | None:
    """The first parameter that differs from value to value of a grid."""
    for name in grid[0]:
        if len({one.get(name) for one in grid}) > 1:
            return name
    return None


def _late(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    spectra: Sequence[Single],
    sign: Vector,
    values: Values,
) -> tuple[float, int, int, Values]:
    """The best single device that begins late: evidence, device, onset row, values.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        spectra: Of the courses.
        sign: Log likelihood ratio of each device over the whole record, shape (D,).
        values: Of the parameters.
    """
    kicks = _kicks(law, scorer, spectra) if law.standing else None
    if kicks is not None:
        sign = sign + np.maximum(kicks.max(axis=0) - np.log(len(kicks)), 0.0)
    hopeful = np.flatnonzero(sign > ONSET_SIGN)
    if not len(hopeful):
        return (-np.inf, 0, 0, values)
    hopeful = hopeful[np.argsort(-sign[hopeful])[:24]]
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
    return (float(gain[onset, device] - cost), int(hopeful[device]), int(rows[row]), values)


def _kicks(law: DeviceLaw, scorer: Scorer, spectra: Sequence[Single]) -> Matrix:
    """Log evidence of a first kick of any size of every device at every step, shape (T, D)."""
    space = scorer.space
    weight = np.mean(1.0 / space.noise.variance(space.transform), axis=0)
    total: Matrix | float = 0.0
    for pattern, spectrum in zip(law.patterns, spectra, strict=True):
        size = _standing(spectrum)
        own = ((pattern.T @ space.noise.modes) ** 2) @ weight * size**2
        pull = (scorer.rows.late @ pattern) * size
        total = total + normal_size(pull, np.broadcast_to(own, pull.shape), 1.0)
    return np.asarray(total)


def _standing(spectrum: Single) -> Vector:
    """Size that a first kick may have, in the units of a course, (D,) or (1,) of (T, D or 1)."""
    return STANDING * np.sqrt(np.mean(spectrum.astype(np.float64) ** 2, axis=0))


def _late_candidates(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    late: tuple[float, int, int, Values],
    cost: float,
) -> list[Candidate]:
    """The finalist that begins late, with and without what its beginning kicks, row by row."""
    _, device, onset, values = late
    if law.standing:
        return [_standing_candidate(kind, law, scorer, device, values, onset, cost)]
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
    return [_candidate(kind, law, scorer, (device,), values, row, free, cost, kick)]


def _standing_candidate(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    device: int,
    values: Values,
    onset: int,
    cost: float,
) -> Candidate:
    """A device that begins late, and kicks by an orbit that stands in it, plane by plane."""
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
    gain = terms.evidence() - cost - _choices(law, (device,)) - np.log(space.transform.rows)
    scaled = {**values, **{one.name: size * values[one.name] for one in kind.sizes}}
    return Candidate(
        kind, (device,), (law.names[device],), scaled, float(gain), onset=onset,
        field=np.asarray(added, dtype=float), sources=(replace(source, size=size * source.size),),
    )  # fmt: skip


def _begun(course: Vector, onset: int, kick: bool) -> Vector:
    """A course that begins at a row, with or without what it has reached by then."""
    base = course[0] if kick else course[onset]
    return np.where(np.arange(len(course)) < onset, 0.0, course - base)


def field_of(
    law: DeviceLaw,
    scorer: Scorer,
    courses: tuple[Matrix, ...],
    places: tuple[int, ...],
    sizes: Vector,
) -> Single:
    """Spectrum of what devices add, shape (T, n) [m]."""
    chosen = list(places) if places else slice(None)
    total = np.zeros(scorer.pulled.shape, dtype=np.float32)
    for pattern, course in zip(law.patterns, courses, strict=True):
        spectrum = scorer.space.transform.quick_spectrum(course)
        along = (pattern[:, chosen] * sizes).T.astype(np.float32)
        total += np.broadcast_to(spectrum, (len(spectrum), len(along))) @ along
    return total


def _candidate(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    places: tuple[int, ...],
    values: Values,
    onset: int,
    free: bool,
    cost: float,
    kick: bool = False,
) -> Candidate:
    """Evaluate a finalist exactly, and give it its size."""
    count = len(places) or len(law.names)
    source = Course(law, places, values, np.ones(count), onset, kick)
    courses = source.of(scorer.space.signals, values)
    field = field_of(law, scorer, courses, places, source.size)
    pull, information = scorer.evaluate([field])
    size = 1.0
    if free:
        size = within(kind, values, float(best_size(pull, information[0], SIZE_WIDTH**2)[0]))
        gain = any_size_at(pull, information[0], size)
    else:
        gain = float(given_size(pull, information[0])[0])
    gain -= cost + _choices(law, places)
    if onset:
        gain -= np.log(scorer.space.transform.rows)
    scaled = {**values}
    for parameter in kind.sizes:
        scaled[parameter.name] = size * values[parameter.name]
    names = tuple(law.names[place] for place in places)
    return Candidate(
        kind, places, names, scaled, gain, onset=onset, field=(size * field).astype(float),
        sources=(replace(source, size=size * source.size),),
    )  # fmt: skip


def _choices(law: DeviceLaw, places: tuple[int, ...]) -> float:
    """What choosing these devices costs [nats]."""
    if not places:
        return 0.0
    alone = len(places) * np.log(len(law.names))
    groups = _as_groups(law, places)
    return float(min(alone, groups * np.log(max(len(law.groups), 2)) if groups else alone))


def _as_groups(law: DeviceLaw, places: tuple[int, ...]) -> int:
    """How many groups the devices are, exactly; 0: they are none."""
    left, used = set(places), 0
    for members in law.groups.values():
        if left and set(map(int, members)) <= left:
            left -= set(map(int, members))
            used += 1
    return 0 if left else used

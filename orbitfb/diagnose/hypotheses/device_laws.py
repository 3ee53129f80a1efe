"""Scan a law of devices over its values, its devices and the rows at which it may begin."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import fminbound

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.priors import (
    MORE,
    MOST_DEVICES,
    ONSET_SIGN,
    SIZE_WIDTH,
    VALUE_COST,
)
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import given_size, normal_size
from orbitfb.estimation.transform import Matrix

_FINENESS = 1.0 / 300.0
"""Share of the interval between two values of the grid to which the best one is found."""

_FINALISTS = 3
"""Values of a grid that are scored for all sets of devices, by each of two marks."""

_WORTH_REFINING = 5.0
"""Nats from which a value is refined."""

_ONSETS_EVERY = 10
"""Rows between the onsets that are tried first."""

_MARGIN = 30
"""Rows at either end of a record within which no onset is tried: too few to tell it by."""


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A set with values, as scanned."""

    evidence: float
    places: tuple[int, ...]
    values: Values
    free: bool


def scan_devices(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> list[Candidate]:
    """Find the best values, devices and onset of one law.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.

    Returns:
        The best candidate that begins with the record, and the best that begins later, if any.
    """
    signals = scorer.space.signals
    grid = kind.grid(signals.record)
    usual = any(block.kind is kind for block in scorer.space.blocks)
    cost = VALUE_COST * len(kind.parameters)
    tops: list[_Found] = []
    late: tuple[float, int, int, Values] = (-np.inf, 0, 0, grid[0])
    for values in _promising(kind, law, scorer, grid):
        courses = law.course(values, signals)
        pull, information = scorer.score(law.patterns, courses)
        tops.append(_best(kind, law, pull, information, values))
        if kind.sudden and not law.whole:
            begun = _late(kind, law, scorer, courses, pull, information, values)
            late = max(late, begun, key=lambda one: one[0])
    if not tops:
        return []
    top = max(tops, key=lambda one: one.evidence)
    candidates = []
    if top.evidence > 0.0 and not usual:
        candidates.append(_refined(kind, law, scorer, grid, top, cost))
    if late[0] > max(0.0, top.evidence):
        candidates += _late_candidates(kind, law, scorer, late, cost)
    return candidates


def _promising(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, grid: Sequence[Values]
) -> list[Values]:
    """The values of a grid that explain most, by device and by all devices together."""
    if len(grid) <= _FINALISTS:
        return list(grid)
    alone, together = np.full(len(grid), -np.inf), np.full(len(grid), -np.inf)
    for number, values in enumerate(grid):
        courses = law.course(values, scorer.space.signals)
        if not any(np.any(course) for course in courses):
            continue
        pull: Vector | float = 0.0
        information: Vector | float = 0.0
        for pattern, course in zip(law.patterns, courses, strict=True):
            part, weight = scorer.apart(pattern, course)
            pull, information = pull + part, information + weight
        own = normal_size(np.asarray(pull), np.asarray(information), 1.0)
        alone[number] = float(np.max(own))
        together[number] = float(np.sum(pull) ** 2 / max(np.sum(information), 1e-300))
    best = {*np.argsort(-alone)[:_FINALISTS], *np.argsort(-together)[:_FINALISTS]}
    return [grid[number] for number in sorted(best) if np.isfinite(alone[number])]


def _best(
    kind: EffectKind, law: DeviceLaw, pull: Vector, information: Matrix, values: Values
) -> _Found:
    """The best set for values of the grid: of the size that they say, or of any."""
    choices = []
    if not kind.linear or not scales(kind):
        choices.append((given_size, False))
    if scales(kind):
        choices.append((_any_size, True))
        if kind.linear and len(kind.parameters) > 1:
            choices.append((given_size, False))
    found = []
    for worth, free in choices:
        gain, places = best_set(
            pull, information, law.groups, worth, whole=law.whole, alone=not kind.collective
        )
        found.append(_Found(gain, places, values, free))
    return max(found, key=lambda one: one.evidence)


def scales(kind: EffectKind) -> bool:
    """Whether a course may have any size: one that runs over a grid of its sizes has them there."""
    return bool(kind.linear) or len(kind.sizes) > 1


def _any_size(pull: Vector, information: Vector) -> Vector:
    return normal_size(pull, information, SIZE_WIDTH**2)


def _refined(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    grid: Sequence[Values],
    top: _Found,
    cost: float,
) -> Candidate:
    """Search between the neighbours of the best value in the grid, by exact evidence."""

    def exact(values: Values) -> Candidate:
        return _candidate(kind, law, scorer, top.places, values, 0, top.free, cost)

    best = exact(top.values)
    name = _running(grid)
    if name is None or top.evidence < _WORTH_REFINING:
        return best
    line = sorted({one[name] for one in grid})
    place = line.index(top.values[name])
    low, high = line[max(place - 1, 0)], line[min(place + 1, len(line) - 1)]
    bend = np.log if low > 0.0 else np.asarray
    back = np.exp if low > 0.0 else np.asarray

    def loss(bent: float) -> float:
        return -exact({**top.values, name: float(back(bent))}).evidence

    span = (float(bend(low)), float(bend(high)))
    fine = _FINENESS * (span[1] - span[0])
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
    courses: tuple[Matrix, ...],
    pull: Vector,
    information: Matrix,
    values: Values,
) -> tuple[float, int, int, Values]:
    """The best single device that begins late: evidence, device, onset row, values."""
    own = np.diag(information)
    sign = pull**2 / (2.0 * np.maximum(own, 1e-300))
    hopeful = np.flatnonzero(sign > ONSET_SIGN)
    if not len(hopeful):
        return (-np.inf, 0, 0, values)
    hopeful = hopeful[np.argsort(-sign[hopeful])[:24]]
    total_pull: Matrix | float = 0.0
    total_information: Matrix | float = 0.0
    onsets = np.zeros(0, dtype=np.intp)
    for pattern, course in zip(law.patterns, courses, strict=True):
        columns = course if course.shape[1] == 1 else course[:, hopeful]
        part, weight, onsets = scorer.since(
            pattern[:, hopeful],
            np.broadcast_to(columns, (len(columns), len(hopeful))),
            _ONSETS_EVERY,
        )
        total_pull, total_information = total_pull + part, total_information + weight
    free = scales(kind)
    worth = _any_size if free else given_size
    gain = worth(np.asarray(total_pull), np.asarray(total_information))
    outside = (onsets < _MARGIN) | (onsets > len(scorer.space.transform) - _MARGIN)
    gain[outside] = -np.inf
    onset, device = np.unravel_index(int(np.argmax(gain)), gain.shape)
    cost = np.log(len(pull)) + np.log(len(onsets))
    rows = scorer.space.transform.step_rows()
    return (
        float(gain[onset, device] - cost),
        int(hopeful[device]),
        int(rows[onsets[onset]]),
        values,
    )


def _late_candidates(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    late: tuple[float, int, int, Values],
    cost: float,
) -> list[Candidate]:
    """The finalist that begins late, with and without what its beginning kicks, row by row."""
    _, device, onset, values = late
    free = scales(kind)
    courses = law.course(values, scorer.space.signals)
    last = scorer.space.transform.rows - 2
    tried = np.arange(max(onset - 2 * _ONSETS_EVERY, 1), min(onset + 2 * _ONSETS_EVERY, last))
    worth = _any_size if free else given_size
    best: tuple[float, int, bool] = (-np.inf, onset, False)
    for kick in (False, True):
        pull: Vector | float = 0.0
        information: Vector | float = 0.0
        for pattern, course in zip(law.patterns, courses, strict=True):
            own = course[:, 0] if course.shape[1] == 1 else course[:, device]
            begun = np.stack([_begun(own, int(row), kick) for row in tried], axis=1)
            part, weight = scorer.quick(pattern[:, device], begun)
            pull, information = pull + part, information + weight
        gain = worth(np.asarray(pull), np.asarray(information))
        place = int(np.argmax(gain))
        best = max(best, (float(gain[place]), int(tried[place]), kick))
    _, row, kick = best
    return [_candidate(kind, law, scorer, (device,), values, row, free, cost, kick)]


def _begun(course: Vector, onset: int, kick: bool) -> Vector:
    """A course that begins at a row, with or without what it has reached by then."""
    base = course[0] if kick else course[onset]
    return np.where(np.arange(len(course)) < onset, 0.0, course - base)


def course_of(
    law: DeviceLaw, scorer: Scorer, values: Values, places: tuple[int, ...], onset: int, kick: bool
) -> tuple[Matrix, ...]:
    """Courses of some devices, nothing before the onset.

    Args:
        law: Of the devices.
        scorer: Of the record.
        values: Of the law.
        places: Devices; empty: all.
        onset: Row at which it begins.
        kick: Whether what it has reached by then comes at once; else only what follows counts.
    """
    chosen = list(places) if places else slice(None)
    found = []
    for course in law.course(values, scorer.space.signals):
        part = course if course.shape[1] == 1 else course[:, chosen]
        if onset:
            part = np.stack([_begun(one, onset, kick) for one in part.T], axis=1)
        found.append(part)
    return tuple(found)


def field_of(
    law: DeviceLaw,
    scorer: Scorer,
    courses: tuple[Matrix, ...],
    places: tuple[int, ...],
    sizes: Vector,
) -> Matrix:
    """Spectrum of what devices add, shape (T, n) [m]."""
    chosen = list(places) if places else slice(None)
    total = np.zeros_like(scorer.pulled)
    for pattern, course in zip(law.patterns, courses, strict=True):
        spectrum = scorer.space.transform.spectrum(course)
        total += (np.broadcast_to(spectrum, (len(spectrum), len(sizes))) * sizes) @ pattern[
            :, chosen
        ].T
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
    courses = course_of(law, scorer, values, places, onset, kick)
    count = len(places) or len(law.names)
    field = field_of(law, scorer, courses, places, np.ones(count))
    pull, information = scorer.evaluate([field])
    size = 1.0
    if free:
        size = float(pull[0] / max(information[0, 0] + SIZE_WIDTH**-2, 1e-300))
        gain = float(_any_size(pull, information[0])[0])
    else:
        gain = float(given_size(pull, information[0])[0])
    gain -= cost + _choices(law, places)
    if onset:
        gain -= np.log(scorer.space.transform.rows)
    scaled = {**values}
    for parameter in kind.sizes:
        scaled[parameter.name] = size * values[parameter.name]
    names = tuple(law.names[place] for place in places)
    return Candidate(kind, places, names, scaled, gain, onset=onset, field=size * field)


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


def sparse_sizes(kind: EffectKind, law: DeviceLaw, scorer: Scorer) -> Iterator[Candidate]:
    """Devices with a size of each one's own, grown greedily; for laws that are linear."""
    usual = any(block.kind is kind for block in scorer.space.blocks)
    if kind.linear is None or law.whole or usual or not kind.collective:
        return
    values = kind.grid(scorer.space.signals.record)[0]
    courses = law.course(values, scorer.space.signals)
    if not any(np.any(np.ptp(course, axis=0)) for course in courses):
        return
    pull, information = scorer.score(law.patterns, courses)
    variance = SIZE_WIDTH**2
    cost = np.log(len(pull))
    chosen: list[int] = []
    best = 0.0
    for _ in range(MOST_DEVICES):
        if chosen:
            inner = information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / variance
            solved = np.linalg.solve(inner, information[chosen])
            left = pull - solved.T @ pull[chosen]
            own = np.diag(information) - np.einsum("kd,kd->d", solved, information[chosen])
        else:
            left, own = pull, np.diag(information)
        gain = normal_size(left, np.maximum(own, 0.0), variance)
        gain[chosen] = -np.inf
        device = int(np.argmax(gain))
        if gain[device] < cost + MORE:
            break
        best += float(gain[device]) - cost
        chosen.append(device)
    if len(chosen) < 2:
        return
    inner = information[np.ix_(chosen, chosen)] + np.eye(len(chosen)) / variance
    sizes = np.linalg.solve(inner, pull[chosen])
    order = tuple(sorted(range(len(chosen)), key=lambda one: chosen[one]))
    places = tuple(chosen[one] for one in order)
    sizes = sizes[list(order)]
    parts = course_of(law, scorer, values, places, 0, False)
    field = field_of(law, scorer, parts, places, np.asarray(sizes, dtype=np.float64))
    pulls, informations = scorer.evaluate([field])
    exact = float(pulls[0] - 0.5 * informations[0, 0])
    occam = 0.5 * float(
        np.linalg.slogdet(np.eye(len(places)) + variance * information[np.ix_(places, places)])[1]
    )
    largest = int(np.argmax(np.abs(sizes)))
    scaled = {**values, kind.linear: float(sizes[largest] * values[kind.linear])}
    yield Candidate(
        kind, places, tuple(law.names[place] for place in places), scaled,
        exact - occam - cost * len(places),
        sizes=tuple(float(size * values[kind.linear]) for size in sizes), field=field,
    )  # fmt: skip

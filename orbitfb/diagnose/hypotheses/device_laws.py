"""Scan a law of devices over its values and its devices."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import (
    Ranked,
    any_size_at,
    cost_of,
    running,
    scales,
    within,
    worths_of,
)
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.diagnose.hypotheses.undone.bent import Undoing, scaled
from orbitfb.diagnose.likelihood.corrected import over
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import best_size, given_size
from orbitfb.estimation.maxima import highest, highest_of
from orbitfb.estimation.priors import (
    FINENESS,
    GRID_REACH,
    NEARBY,
    SIZE_WIDTH,
)
from orbitfb.estimation.transform import Matrix

_BESIDE = 0.3
"""A value that a law is complete without is first tried at this share of the one of its unit that
the grid runs over. By hand: where it shows it is found from there."""


@dataclass(frozen=True, slots=True, eq=False)
class _Found:
    """A set with values, as scanned."""

    evidence: float
    places: tuple[int, ...]
    values: Values
    free: bool


def scan_devices(kind: EffectKind, law: DeviceLaw, scorer: Scorer, rank: Ranked) -> list[Candidate]:
    """Find the best values and devices of one law.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best candidates of all devices and of some of them.
    """
    usual = scorer.is_usual(kind)
    every: list[_Found] = []
    some: list[_Found] = []
    for values in rank.promising:
        for found in _sets(kind, law, scorer, values):
            (some if found.places else every).append(found)
    candidates = []
    tops = [max(found, key=lambda one: one.evidence, default=None) for found in (every, some)]
    if some and not scales(kind):  # errors of its neighbours hide that a single one is enough
        worth = rank.alone[: len(rank.grid)]
        number, device = map(int, np.unravel_index(int(np.argmax(worth)), worth.shape))
        alone = _Found(float(worth[number, device]), (device,), rank.grid[number], False)
        tops.append(alone if tops[1] is None or tops[1].places != alone.places else None)
    for top in tops:
        if top is not None and top.evidence > 0.0 and not usual:
            names = tuple(law.names[place] for place in top.places)
            cost = cost_of(kind, top.values, scorer)
            candidates.append(
                Candidate(
                    kind, top.places, names, top.values, top.evidence - cost,
                    finer=partial(_finer, kind, law, scorer, rank.grid, top),
                )
            )  # fmt: skip
    return candidates


def _sets(kind: EffectKind, law: DeviceLaw, scorer: Scorer, values: Values) -> Iterator[_Found]:
    """All devices, and the best set of some of them, with given values."""
    spectra = scorer.space.courses.spectra(law, values)
    pull, information = scorer.score(law.patterns, spectra)
    information = scorer.marginal(kind, law.patterns, spectra, information)
    for worth, free in worths_of(kind):
        gain, places = best_set(pull, information, law.groups, worth, alone=not kind.collective)
        yield _Found(gain, places, values, free)
        if places and kind.collective:
            gain = float(worth(np.array([pull.sum()]), np.array([information.sum()]))[0])
            yield _Found(gain, (), values, free)


def _finer(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    grid: Sequence[Values],
    top: _Found,
) -> Candidate:
    """Be exact, and search between the neighbours of the best value in the grid.

    A value that is off by a step of the grid strikes too few devices or too many: first both are
    sought at once, as they are scanned, then the value alone, exactly.
    """

    def exact(places: tuple[int, ...], values: Values) -> Candidate:
        cost = cost_of(kind, values, scorer)
        return evaluated(kind, law, scorer, places, values, 0, top.free, cost)

    best, name = exact(top.places, top.values), running(grid)
    if name is None or best.evidence <= 0.0:
        return best
    line = sorted({one[name] for one in grid})
    place, places, values = line.index(top.values[name]), top.places, top.values
    ends = _around(line, place)
    if len(places) > 1:
        spaced = np.geomspace if ends[0] > 0.0 else np.linspace
        some = [
            one
            for value in np.asarray(spaced(*ends, num=NEARBY)).tolist()
            for one in _sets(kind, law, scorer, {**values, name: value})
            if one.places and one.free == top.free
        ]
        found = max(some, default=top, key=lambda one: one.evidence)
        places, values = found.places, found.values

    def near(value: float) -> float:
        return exact(places, {**values, name: value}).evidence

    while True:
        value = highest(near, ends, FINENESS)
        fine = exact(places, {**values, name: value})
        nearest = min(range(len(line)), key=lambda at: abs(line[at] - value))
        if fine.evidence <= best.evidence or line[nearest] not in ends or nearest == place:
            best = max(best, fine, key=lambda one: one.evidence)
            return _in_all_values(kind, law, scorer, best, name, top.free)
        best, place, ends = fine, nearest, _around(line, nearest)  # the highest may lie beyond


def _in_all_values(
    kind: EffectKind, law: DeviceLaw, scorer: Scorer, best: Candidate, name: str, free: bool
) -> Candidate:
    """Seek all values at once, if there are others than the one that the grid runs over.

    What is complete without a value may have it as well: one of the same unit as that which runs,
    such as a second time constant, begins at a share of that.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        best: With the value that the grid runs over at its best.
        name: Of that value.
        free: Whether it may have any size.
    """
    known = best.sources[0].values
    unit = next(one.unit for one in kind.parameters if one.name == name)
    begin, bounds = {name: known[name]}, {}
    for parameter in kind.fitted(scorer.space.signals.record):
        bounds[parameter.name] = parameter.low, parameter.high
        now = known.get(parameter.name, parameter.nominal)
        if parameter.optional and now == parameter.nominal and parameter.unit == unit:
            now = _BESIDE * known[name]
        elif parameter.optional and now == parameter.nominal:
            continue
        if parameter.log and not parameter.whole and parameter not in kind.sizes:
            begin[parameter.name] = now
    if len(begin) == 1 or min(begin.values()) <= 0.0:
        return best

    def at(values: Values) -> Candidate:
        told = {**known, **values}
        cost = cost_of(kind, told, scorer)
        return evaluated(kind, law, scorer, best.places, told, 0, free, cost)

    found = highest_of(lambda values: at(values).evidence, begin, bounds)
    return max(best, at(found), key=lambda one: one.evidence)


def _around(line: Sequence[float], place: int) -> tuple[float, float]:
    """Values of a grid beside one of them."""
    return line[max(place - GRID_REACH, 0)], line[min(place + GRID_REACH, len(line) - 1)]


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


def evaluated(
    kind: EffectKind,
    law: DeviceLaw,
    scorer: Scorer,
    places: tuple[int, ...],
    values: Values,
    onset: int,
    free: bool,
    cost: float,
    kick: bool = False,
    first: Vector | None = None,
    own: Mapping[str, Vector] | None = None,
) -> Candidate:
    """Evaluate a set of devices exactly, and give it its size.

    Args:
        kind: The effect.
        law: Of its devices.
        scorer: Of what is left to explain.
        places: Devices; empty: all.
        values: Of the parameters.
        onset: Row at which it begins; 0: with the record.
        free: Whether it may have any size.
        cost: Of its values [nats].
        kick: Whether what it has reached by the onset comes at once.
        first: State of the devices in the first row, shape (k,); None: not asked.
        own: Factors by which values of every device differ, shape (k,), by parameter; None: none.
    """
    count = len(places) or len(law.names)
    source = Course(law, places, values, np.ones(count), onset, kick, first, own or {})
    courses = source.of(scorer.space.signals, values)
    field = field_of(law, scorer, courses, places, source.size)
    pull, information = scorer.evaluate([field])
    size, paid = 1.0, cost + choices(law, places)
    undoing = None
    if onset:
        paid += float(np.log(scorer.space.transform.rows))
    if free:
        size = within(kind, values, float(best_size(pull, information[0], SIZE_WIDTH**2)[0]))
        gain, field = any_size_at(pull, information[0], size), size * field
        worth = float(pull[0] * size - 0.5 * information[0, 0] * size**2)
        paid += worth - gain
        if law.undone is not None and len(places) == 1 and gain > 0.0:
            undoing = Undoing.of(kind, scorer, source)
    else:
        worth = float(given_size(pull, information[0])[0])
    names = tuple(law.names[place] for place in places)
    told = scaled(kind, source, size)
    if undoing is not None and undoing.bends(told, worth):
        found = Candidate(kind, places, names, told.values, 0.0, onset=onset, cost=paid)
        return _undone(found, told, undoing)
    return Candidate(
        kind, places, names, told.values, worth - paid, onset=onset, field=field.astype(float),
        sources=(replace(source, size=size * source.size),), cost=paid,
    )  # fmt: skip


def _undone(one: Candidate, source: Course, undoing: Undoing) -> Candidate:
    """A BPM with the sizes that undo its readings, over any floor."""

    def again(after: Workspace) -> Candidate:
        lower = Scorer.of(over(undoing.scorer.space, after))
        return _undone(one, best, Undoing.of(one.kind, lower, best))

    best, worth, field = undoing.best(source)
    return replace(
        one, values=best.values, evidence=worth - (one.cost or 0.0), field=field.astype(float),
        sources=(best,), again=again,
    )  # fmt: skip


def choices(law: DeviceLaw, places: tuple[int, ...]) -> float:
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

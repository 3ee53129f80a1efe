"""Scan a law of devices over its values and its devices."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import fminbound

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.ranking import (
    Ranked,
    any_size_at,
    within,
    worths_of,
)
from orbitfb.diagnose.hypotheses.refit import Course
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.hypotheses.sets import best_set
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw
from orbitfb.estimation.evidence import best_size, given_size
from orbitfb.estimation.priors import (
    FINENESS,
    GRID_REACH,
    SIZE_WIDTH,
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
    """Find the best values and devices of one law.

    Args:
        kind: The effect.
        law: One of its laws.
        scorer: Of what is left to explain.
        rank: Of the values of its grid.

    Returns:
        The best candidates of all devices and of some of them.
    """
    grid = rank.grid
    usual = any(block.kind is kind and not block.accepted for block in scorer.space.blocks)
    cost = VALUE_COST * len(kind.parameters)
    every: list[_Found] = []
    some: list[_Found] = []
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
    candidates = []
    for found in (every, some):
        top = max(found, key=lambda one: one.evidence, default=None)
        if top is not None and top.evidence > 0.0 and not usual:
            candidates.append(_refined(kind, law, scorer, grid, top, cost))
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
        return evaluated(kind, law, scorer, top.places, values, 0, top.free, cost)

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
    """
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
    gain -= cost + choices(law, places)
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

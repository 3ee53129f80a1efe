"""Try every row of a record as the beginning of an effect."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from scipy.fft import next_fast_len

from orbitfb.core.signals import Vector
from orbitfb.diagnose.candidate import (
    FIRST_ONSET,
    KEPT,
    LAST_ONSET,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.device_groups import Group, each_alone
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.scan_changes import Changes, Shapes
from orbitfb.diagnose.scan_groups import Groups
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.diagnose.standing import price_of_steps
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_STRIDE = 4
"""Rows of which one is tried as the beginning of a group: there are many groups."""


@dataclass(frozen=True, slots=True, eq=False)
class _Beginnings:
    """Best row of S sets of places with strength and gain there, (S,); of how many rows."""

    row: Indices
    strength: Vector
    gain: Vector
    rows: int


def onsets(
    scoring: Scoring,
    kind: EffectKind,
    values: Values,
    changes: Changes,
    groups: Groups | None,
    *,
    free: bool = False,
) -> Iterator[Candidate]:
    """Try every row as the beginning, place by place and group by group.

    Args:
        scoring: On a bench.
        kind: The effect.
        values: That made the changes.
        changes: Of all places.
        groups: Of them; None where each is struck by itself.
        free: Whether the first step is free.
    """
    rows = len(changes.parts[0][1])
    score, info, jumps = (np.zeros((rows, len(changes.score))) for _ in range(3))
    holds = free or holding(kind)
    for shapes, drivers in changes.parts:
        score += to_the_end(shapes.pull * drivers)
        if holds:
            score -= to_the_end(shapes.pull) * drivers
        first = np.zeros_like(drivers) if holds else drivers
        for level, shape in enumerate(shapes.fine):
            energy, jump = scoring.begun(level, drivers, first)
            size = np.sum(shape**2, axis=0)
            info += size * energy
            jumps += size * jump
    single = _highest(kind, score, info)
    yield from _beginnings(kind, values, single, each_alone(info.shape[1]), free=free)
    if groups is not None:
        member, some = groups.member, slice(None, None, _STRIDE)
        apart = info[some] @ member.T
        shown = groups.shown(np.arange(0, rows, _STRIDE), jumps[some])
        found = _highest(kind, score[some] @ member.T, apart * shown, _STRIDE)
        if free:  # what one step gains or costs is the fit's affair, that of many a group's
            (shapes, _), *_ = changes.parts
            prices = price_of_steps(_steps(scoring, shapes, rows)[found.row])
            found.gain[:] -= np.sum(member * prices, axis=1)
        # a group that gains no more than one of its devices is that device
        found.gain[found.gain <= np.max(member * single.gain, axis=1)] = 0.0
        yield from _beginnings(kind, values, found, groups.each, free=free)


def _steps(scoring: Scoring, shapes: Shapes, rows: int) -> Matrix:
    """Information on a step at every row, place by place, shape (N, P).

    It is seen against the rows before it that the filter remembers, by the rows after it until
    the filter has followed.
    """
    still = np.zeros((rows, 1))
    lasting = [scoring.begun(k, still, still + 1.0)[0] for k in range(len(shapes.fine))]
    sizes = [np.sum(shape**2, axis=0) for shape in shapes.fine]
    return np.sum([last * size for last, size in zip(lasting, sizes, strict=True)], axis=0)


def growing(
    scoring: Scoring, kind: ActuatorKind | SensorKind | SourceKind, grid: Sequence[Values]
) -> Iterator[Candidate]:
    """Try every row as the beginning of what grows from nothing there.

    Its course is the same from every row on, only later: the scores of all rows are one
    correlation, and what the record tells of it sums up from the end. A course that all
    places share is assumed, and one unbroken stretch.

    Args:
        scoring: On a bench.
        kind: The effect.
        grid: Values to try.
    """
    for values in grid:
        (shapes, drivers), *_ = scoring.changes(kind, values).parts
        rows, course = len(drivers), drivers[:, :1]
        lines = cast("int", next_fast_len(2 * rows, real=True))
        turned = np.conj(np.fft.rfft(course, lines, axis=0))
        pulled = np.fft.rfft(shapes.pull, lines, axis=0)
        score = np.fft.irfft(pulled * turned, lines, axis=0)[:rows]
        info: Vector = np.zeros(score.shape)
        for shape, left in zip(shapes.fine, scoring.courses(course), strict=True):
            energy = np.cumsum(left[:, 0] ** 2)[::-1]
            info += energy[:, None] * np.sum(shape**2, axis=0)
        sets = each_alone(score.shape[1])
        yield from _beginnings(kind, values, _highest(kind, score, info), sets)


def holding(kind: EffectKind) -> bool:
    """Whether it makes no step where it begins: a corrector holds what it had, or it is free."""
    if isinstance(kind, ActuatorKind):
        return not kind.vanishes
    return isinstance(kind, SourceKind) and kind.standing


def _highest(kind: EffectKind, score: Matrix, info: Matrix, stride: int = 1) -> _Beginnings:
    """Find the best row of every set from scores and information from every row on, (N, S).

    Those of every so many rows do: a beginning is looked for again near the row proposed.
    """
    strength, gain = best_strength(kind, score, info)
    gain[: -(-FIRST_ONSET // stride)] = 0.0
    gain[len(gain) - LAST_ONSET // stride :] = 0.0
    row, column = np.argmax(gain, axis=0), np.arange(gain.shape[1])
    rows = len(gain) * stride
    return _Beginnings(row * stride, strength[row, column], gain[row, column], rows)


def _beginnings(
    kind: EffectKind,
    values: Values,
    found: _Beginnings,
    sets: Sequence[Group],
    *,
    free: bool = False,
) -> Iterator[Candidate]:
    """Propose the best of the sets."""
    prices = np.log([its.choices for its in sets])
    for index in np.argsort(found.gain - prices)[::-1][:KEPT]:
        if found.gain[index] > 0:
            name, members, choices = sets[int(index)]
            scaled = sized(kind, values, float(found.strength[index]))
            cause = Cause(kind, tuple(members.tolist()), scaled, int(found.row[index]), free)
            yield Candidate(cause, float(found.gain[index]), found.rows * choices, name)


def to_the_end(values: Matrix) -> Matrix:
    """Sum from every row to the last one, over the first axis."""
    return np.cumsum(values[::-1], axis=0)[::-1]

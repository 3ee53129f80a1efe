"""One adjoint pass scores every place of every effect.

An effect of strength a at one place changes the prediction by a δ. To second order the
log-likelihood gains a s − ½ a² J, with the score s = Σ λ δ and the information J = Σ (F δ)² / S:
so a = s / J and the gain is ½ s² / J. δ is a pattern times a driver, so that s of all places is
one product with λ and J a sum over a few ladder filters.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.candidate import (
    FIRST_ONSET,
    KEPT,
    LAST_ONSET,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.device_groups import groups_of
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import information
from orbitfb.diagnose.problem import highest
from orbitfb.diagnose.scan_between import Heights, between
from orbitfb.diagnose.scan_colour import of_colour
from orbitfb.diagnose.scan_pairs import of_pairs
from orbitfb.diagnose.scan_shapes import Changes, Scoring
from orbitfb.diagnose.scan_special import of_families, of_ring, periodic
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_WORTH = 3.0
"""Gain below which a candidate is not looked at [nats]."""


class Scanner:
    """Scores places on one bench.

    Args:
        bench: The record under the causes so far.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._scoring = Scoring(bench)

    def candidates(self, kind: EffectKind) -> list[Candidate]:
        """Find the best places of one kind, best first; empty when nothing is gained."""
        found: list[Candidate] = []
        if isinstance(kind, PairKind):
            found = list(of_pairs(self._bench, self._scoring, kind))
        elif getattr(kind, "periodic", False) and isinstance(kind, SourceKind):
            found = list(periodic(self._bench, kind))
        elif kind.target == "ring" and isinstance(kind, RingKind | ActuatorKind):
            found = list(of_ring(self._bench, self._scoring, kind))
        elif isinstance(kind, ActuatorKind | SensorKind | SourceKind):
            found = list(self._placed(kind))
        if isinstance(kind, SourceKind):
            found += of_families(self._bench, self._scoring, kind)
        if isinstance(kind, SensorKind) and kind.colours:
            found += of_colour(self._bench, kind)
        best: dict[tuple[tuple[int, ...], bool, bool], Candidate] = {}
        for candidate in found:
            cause = candidate.cause
            key = (cause.places, cause.onset > 0, cause.free)
            if key not in best or candidate.gain > best[key].gain:
                best[key] = candidate
        ranked = sorted(best.values(), key=lambda c: c.gain - np.log(c.choices), reverse=True)
        return ranked[:KEPT]

    def _placed(self, kind: ActuatorKind | SensorKind | SourceKind) -> Iterator[Candidate]:
        """Scan a grid of values for single places and for all; look closer at the best values."""
        closer: dict[str, tuple[float, Values, Changes]] = {}
        grid = self._grid(kind)
        heights: list[Heights] = []

        def look(values: Values) -> Iterator[Candidate]:
            changes = self._scoring.changes(kind, values)
            heights.append(self._heights(kind, changes))
            steady = list(self._steady(kind, values, changes))
            yield from steady
            tried = {"single": max((c.gain for c in steady), default=0.0)}
            if kind.collective and isinstance(kind, ActuatorKind | SensorKind):
                tried["all"] = self._all(kind, changes)
                tried["cell"] = self._cell(kind, changes)
            for what, gain in tried.items():
                if what not in closer or gain > closer[what][0]:
                    closer[what] = (gain, values, changes)

        def height(values: Values) -> Heights:
            return self._heights(kind, self._scoring.changes(kind, values))

        for values in grid:
            yield from look(values)
        for values in list(between(kind, grid, heights, height)):
            yield from look(values)
        if isinstance(kind, ActuatorKind):
            shapes = self._scoring.correctors()
            for values in kind.hints(self._bench.currents, shapes.pull, self._bench.record):
                yield from look(values)
        if "all" in closer:
            yield from self._groups(kind, *closer["all"][1:])
            if closer["cell"][1] is not closer["all"][1]:
                yield from self._groups(kind, *closer["cell"][1:])
        if kind.sudden and kind.grows:
            yield from self._growing(kind, grid)
        elif kind.sudden and "single" in closer:
            yield from self._onsets(kind, *closer["single"][1:])
            if isinstance(kind, ActuatorKind) and kind.linear is not None:
                yield from self._onsets(kind, *closer["single"][1:], free=True)

    def _grid(self, kind: EffectKind) -> list[Values]:
        """Values to look at, but those that the rate of the record cannot show."""
        record = self._bench.record
        rate = 1.0 / record.layout.period
        return [
            values
            for values in kind.grid(record)
            if all(values[p.name] <= highest(p, rate) for p in kind.parameters)
        ]

    def _heights(self, kind: EffectKind, changes: Changes) -> Heights:
        """Best score of a place, and of a cell whose places are struck alike."""
        heights = {"single": float(changes.score.max(initial=0.0))}
        if kind.collective and isinstance(kind, ActuatorKind | SensorKind):
            sums = self._by_cell(kind, changes)[1]
            heights["cell"] = float(sums.max(initial=0.0))
        return heights

    def _by_cell(
        self, kind: ActuatorKind | SensorKind, changes: Changes
    ) -> tuple[list[Indices], Vector]:
        """Places of every cell, and the sum of their scores."""
        layout = self._bench.record.layout
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        cells = list(devices.groups().values())
        return cells, np.array([changes.score[columns].sum() for columns in cells])

    def _cell(self, kind: ActuatorKind | SensorKind, changes: Changes) -> float:
        """Best gain if every place of one cell were struck alike."""
        cells, sums = self._by_cell(kind, changes)
        if not len(sums) or (kind.linear is None and sums.max() < _WORTH):
            return 0.0
        infos = self._scoring.together(changes, cells)
        return float(best_strength(kind, sums, infos)[1].max())

    def _all(self, kind: EffectKind, changes: Changes) -> float:
        """Gain if every place were struck alike, as far as healthy errors do not do the same."""
        (shapes, drivers), *_ = changes.parts
        score = changes.score.sum(keepdims=True)
        if kind.linear is None and score[0] < _WORTH:
            return 0.0  # it cannot gain more than its score
        keep = np.sqrt(1.0 - changes.information[1])
        info = self._scoring.seen((drivers * keep) @ shapes.patterns.T)
        return float(best_strength(kind, score, np.array([info]))[1][0])

    def _steady(self, kind: EffectKind, values: Values, changes: Changes) -> Iterator[Candidate]:
        score = changes.score
        if kind.linear is None and score.max(initial=0.0) < _WORTH:
            return  # a change cannot gain more than its score
        info, absorbed = changes.information
        yield from self._singles(kind, values, score, info * (1.0 - absorbed))

    def _singles(
        self, kind: EffectKind, values: Values, score: Vector, info: Vector
    ) -> Iterator[Candidate]:
        strength, gain = best_strength(kind, score, info)
        for place in np.argsort(gain)[::-1][:KEPT]:
            if gain[place] > 0:
                yield Candidate(
                    Cause(kind, (int(place),), sized(kind, values, float(strength[place]))),
                    float(gain[place]),
                    len(score),
                )

    def _groups(self, kind: EffectKind, values: Values, changes: Changes) -> Iterator[Candidate]:
        """Try all devices, those of a plane, and every run of neighbouring cells."""
        layout = self._bench.record.layout
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        score = changes.score
        (shapes, drivers), *_ = changes.parts
        matrix = information(shapes.fine, self._scoring.courses(drivers))
        absorbed = changes.information[1]
        keep = np.sqrt(1.0 - absorbed)
        matrix *= np.outer(keep, keep)
        groups = list(groups_of(devices.groups(), len(devices), devices.planes))
        member = np.zeros((len(groups), len(devices)))
        for row, (_, columns) in enumerate(groups):
            member[row, columns] = 1.0
        info = np.einsum("gp,gp->g", member @ matrix, member)
        strength, gain = best_strength(kind, member @ score, info)
        yield from self._singles(kind, values, score, np.diagonal(matrix))
        # a group that gains no more than one of its devices is that device
        alone = best_strength(kind, score, np.diagonal(matrix))[1]
        gain[gain <= np.max(member * alone, axis=1)] = 0.0
        for group in np.argsort(gain)[::-1][:KEPT]:
            if gain[group] > 0:
                name, members = groups[int(group)]
                scaled = sized(kind, values, float(strength[group]))
                yield Candidate(
                    Cause(kind, tuple(int(i) for i in members), scaled),
                    float(gain[group]),
                    float(len(groups)),
                    name,
                )

    def _onsets(
        self, kind: EffectKind, values: Values, changes: Changes, *, free: bool = False
    ) -> Iterator[Candidate]:
        """Try every row as the beginning, place by place; with a free first step if so asked."""
        score = _sum(shapes.pull * drivers for shapes, drivers in changes.parts)
        later_score = np.cumsum(score[::-1], axis=0)[::-1]
        later = np.zeros_like(later_score)
        row = np.arange(len(score), dtype=np.float64)
        short = 1.0 / np.maximum(row, 1.0) + 1.0 / (len(row) - row)
        holds = free or holding(kind)
        if holds:
            for shapes, drivers in changes.parts:
                pull = np.cumsum(shapes.pull[::-1], axis=0)[::-1]
                later_score = later_score - pull * drivers
        for shapes, drivers in changes.parts:
            for shape, course, feedback in zip(
                shapes.fine,
                self._scoring.courses(drivers),
                self._scoring.ladder.feedback,
                strict=True,
            ):
                size = np.sum(shape**2, axis=0)
                later += size * np.cumsum((course**2)[::-1], axis=0)[::-1]
                if not holds:
                    # A step is seen against the rows before it that the filter remembers, by the
                    # rows after it until the filter has followed.
                    later += size * drivers**2 / (1.0 - feedback**2 + short)[:, None]
        strength, gain = best_strength(kind, later_score, later)
        gain[:FIRST_ONSET] = 0.0
        gain[len(gain) - LAST_ONSET :] = 0.0
        best = np.argmax(gain, axis=0)
        height = gain[best, np.arange(gain.shape[1])]
        for place in np.argsort(height)[::-1][:KEPT]:
            row = int(best[place])
            if height[place] > 0:
                scaled = sized(kind, values, float(strength[row, place]))
                yield Candidate(
                    Cause(kind, (int(place),), scaled, row, free),
                    float(height[place]),
                    float(gain.size),
                )

    def _growing(
        self, kind: ActuatorKind | SensorKind | SourceKind, grid: Sequence[Values]
    ) -> Iterator[Candidate]:
        """Try every row as the beginning of what grows from nothing there.

        Its course is the same from every row on, only later: the scores of all rows are one
        correlation, and what the record tells of it sums up from the end. A course that all
        places share is assumed, and one unbroken stretch.
        """
        for values in grid:
            (shapes, drivers), *_ = self._scoring.changes(kind, values).parts
            rows, course = len(drivers), drivers[:, :1]
            turned = np.conj(np.fft.rfft(course, 2 * rows, axis=0))
            pulled = np.fft.rfft(shapes.pull, 2 * rows, axis=0)
            score = np.fft.irfft(pulled * turned, axis=0)[:rows]
            info: Vector = np.zeros(score.shape)
            for shape, left in zip(shapes.fine, self._scoring.courses(course), strict=True):
                energy = np.cumsum(left[:, 0] ** 2)[::-1]
                info += energy[:, None] * np.sum(shape**2, axis=0)
            strength, gain = best_strength(kind, score, info)
            gain[:FIRST_ONSET] = 0.0
            gain[rows - LAST_ONSET :] = 0.0
            best = np.argmax(gain, axis=0)
            height = gain[best, np.arange(gain.shape[1])]
            for place in np.argsort(height)[::-1][:KEPT]:
                row = int(best[place])
                if height[place] > 0:
                    scaled = sized(kind, values, float(strength[row, place]))
                    cause = Cause(kind, (int(place),), scaled, row)
                    yield Candidate(cause, float(height[place]), float(gain.size))


def holding(kind: EffectKind) -> bool:
    """Whether it makes no step where it begins: a corrector holds what it had, or it is free."""
    if isinstance(kind, ActuatorKind):
        return not kind.vanishes
    return isinstance(kind, SourceKind) and kind.standing


def _sum(terms: Iterator[Matrix]) -> Matrix:
    total = next(terms)
    for term in terms:
        total = total + term
    return total

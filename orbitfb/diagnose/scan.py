"""One adjoint pass scores every place of every effect.

An effect of strength a at one place changes the prediction by a δ. To second order the
log-likelihood gains a s − ½ a² J, with the score s = Σ λ δ and the information J = Σ (F δ)² / S:
so a = s / J and the gain is ½ s² / J. δ is a pattern times a driver, so that s of all places is
one product with λ and J a sum over a few ladder filters.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import (
    KEPT,
    LEAST_INFORMATION,
    Candidate,
    best_strength,
    sized,
)
from orbitfb.diagnose.device_groups import cells
from orbitfb.diagnose.problem import highest
from orbitfb.diagnose.scan_between import Heights, between
from orbitfb.diagnose.scan_changes import Changes
from orbitfb.diagnose.scan_colour import of_colour
from orbitfb.diagnose.scan_groups import Groups, of_groups, of_places
from orbitfb.diagnose.scan_onsets import growing, onsets
from orbitfb.diagnose.scan_pairs import of_pairs
from orbitfb.diagnose.scan_shapes import Scoring
from orbitfb.diagnose.scan_special import of_families, of_ring, periodic
from orbitfb.effects.device_kinds import ActuatorKind, PairKind, SensorKind
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.orbit_kinds import RingKind, SourceKind
from orbitfb.physics.places import Indices

_STRIKING = 8.0
"""Gain from which a group that is struck late is looked at closely [nats]."""
_WORTH = 5.0
"""Gain below which a candidate is not looked at: what its choice among all places costs [nats]."""


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
        best = _Best()

        def look(values: Values) -> Iterator[Candidate]:
            changes = self._scoring.changes(kind, values)
            heights.append(self._heights(kind, changes))
            steady = list(self._steady(kind, values, changes, best))
            yield from steady
            tried = {"single": max((c.gain for c in steady), default=0.0)}
            if kind.collective and isinstance(kind, ActuatorKind | SensorKind):
                for what, groups in self._struck(kind).items():
                    least = closer[what][0] if what in closer else 0.0
                    tried[what] = self._together(kind, changes, groups, least)
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
        layout, groups = self._bench.record.layout, dict[int, Groups]()
        if "all" in closer:
            for _, values, changes in (closer["all"], closer["cell"]):
                if id(changes) not in groups:
                    own = groups[id(changes)] = Groups.of(self._scoring, layout, kind, changes)
                    yield from of_groups(kind, values, changes.score, own)
        if kind.sudden and kind.grows:
            yield from growing(self._scoring, kind, grid)
        elif kind.sudden and "single" in closer:
            _, values, changes = closer["single"]
            own = groups.get(id(changes))
            if own is None and "all" in closer:
                own = Groups.of(self._scoring, layout, kind, changes)
            for candidate in onsets(self._scoring, kind, values, changes, own):
                yield self._measured(candidate, grid)
            if isinstance(kind, ActuatorKind) and kind.of_changes:
                for candidate in onsets(self._scoring, kind, values, changes, own, free=True):
                    yield self._measured(candidate, grid)

    def _measured(self, candidate: Candidate, grid: Sequence[Values]) -> Candidate:
        """Judge a group that is struck late by what it really does, at all values of a grid.

        The best value of the whole record, where the group is struck in a part of it, is not its.
        And devices that move together and apart by turns hide no usual part of each other: what
        they would tell together is an estimate, which must not stand in the way of single ones.
        """
        cause, bench = candidate.cause, self._bench
        if not candidate.group or candidate.gain < _STRIKING:
            return candidate
        if cause.kind.linear is not None:
            # What the likelihood falls short of a parabola's top is information that was missed.
            found = log_likelihood(*bench.residual((cause,))) - bench.log_likelihood
            share = candidate.gain / max(2.0 * candidate.gain - found, candidate.gain)
            there = replace(cause, values=sized(cause.kind, cause.values, share))
            return replace(candidate, cause=there, gain=share * candidate.gain)
        usual = log_likelihood(*bench.roughly(()))

        def height(values: Values) -> float:
            return log_likelihood(*bench.roughly((replace(cause, values=values),))) - usual

        values = max((cause.values, *grid), key=height)
        gain = max(height(values), 0.0)
        return replace(candidate, cause=replace(cause, values=values), gain=gain)

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
            struck = self._struck(kind)["cell"]
            heights["cell"] = max((float(changes.score[own].sum()) for own in struck), default=0.0)
        return heights

    def _struck(self, kind: ActuatorKind | SensorKind) -> dict[str, list[Indices]]:
        """Places that may be struck alike: all, and those of every cell."""
        layout = self._bench.record.layout
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        return {
            "all": [np.arange(len(devices), dtype=np.intp)],
            "cell": cells(devices),
        }

    def _together(
        self, kind: EffectKind, changes: Changes, groups: Sequence[Indices], least: float
    ) -> float:
        """Best gain if every place of one group were struck alike; 0 if it is not above a least.

        As far as healthy errors do not do the same.
        """
        score = np.array([changes.score[own].sum() for own in groups])
        most = _most(kind, score, changes.least_together(groups))
        able = np.flatnonzero(most > max(least, _WORTH))
        if not len(able):
            return 0.0
        infos = self._scoring.together(changes, [groups[int(index)] for index in able])
        return max(float(best_strength(kind, score[able], infos)[1].max()), 0.0)

    def _steady(
        self, kind: EffectKind, values: Values, changes: Changes, best: "_Best"
    ) -> Iterator[Candidate]:
        """Propose single places that may be among the best ones."""
        score = changes.score
        able = np.flatnonzero(_most(kind, score, changes.least) > max(best.least, _WORTH))
        if not len(able):
            return
        info, absorbed = self._scoring.information(changes, able)
        known = np.zeros_like(score)
        known[able] = info * (1.0 - absorbed)
        for candidate in of_places(kind, values, score, known):
            best.add(candidate)
            yield candidate


class _Best:
    """Gains of the best places of a kind so far."""

    def __init__(self) -> None:
        self._gains: dict[int, float] = {}

    @property
    def least(self) -> float:
        """Gain that a place needs to be among them [nats]."""
        gains = sorted(self._gains.values(), reverse=True)
        return gains[KEPT - 1] if len(gains) >= KEPT else 0.0

    def add(self, candidate: Candidate) -> None:
        """Take notice of a place."""
        (place,) = candidate.cause.places
        self._gains[place] = max(candidate.gain, self._gains.get(place, 0.0))


def _most(kind: EffectKind, score: Vector, least: Vector) -> Vector:
    """Gain of changes, at most, by the information on them, at least."""
    if not kind.sizes:
        return score - 0.5 * least
    return 0.5 * score**2 / np.maximum(least, LEAST_INFORMATION)

"""One adjoint pass scores every place of every effect.

An effect of strength a at one place changes the prediction by a δ. To second order the
log-likelihood gains a s − ½ a² J, with the score s = Σ λ δ and the information J = Σ (F δ)² / S:
so a = s / J and the gain is ½ s² / J. δ is a pattern times a driver, so that s of all places is
one product with λ and J a sum over a few ladder filters.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.innovation import Ladder, information
from orbitfb.effects.kinds import (
    ActuatorKind,
    EffectKind,
    PairKind,
    RingKind,
    SensorKind,
    SourceKind,
    Values,
)
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_LAST_ONSET = 40
_FIRST_ONSET = 20
"""Rows at the ends of a record in which no onset is looked for."""
_KEPT = 3
_ONSETS_TRIED = 4
"""Onsets at which the information on an effect of the whole ring is computed."""
_FINER = 4
"""Lines of the spectrum per line that the length of the record resolves."""
_ROUGH = 3
"""Levels of the ladder for the first look at a whole grid of values."""
_WORTH = 3.0
"""Gain below which a candidate is not looked at [nats]."""
_LEAST_INFORMATION = 1e-3
"""Information below which a change of typical size leaves no trace [nats]."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A cause that the scan thinks worth a fit.

    Args:
        cause: What, where, how large (roughly), since when.
        gain: Estimated gain of the log-likelihood [nats].
        choices: Among how many places and onsets it was chosen.
        group: Name of the group of devices that it strikes; empty for single ones.
    """

    cause: Cause
    gain: float
    choices: float
    group: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Shapes:
    """Patterns of P places, and what depends on nothing else.

    Args:
        patterns: Shape (n, P).
        pull: λ · pattern of every row, shape (N, P).
        fine: In the levels of the ladder.
        rough: In the levels of the rough ladder.
    """

    patterns: Matrix
    pull: Matrix
    fine: list[Matrix]
    rough: list[Matrix]


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """Changes of the prediction by P places: Σ over parts of pattern · driver.

    Args:
        parts: Pairs of shapes and drivers (N, P) or (N, 1).
    """

    parts: tuple[tuple[Shapes, Matrix], ...]


class Scanner:
    """Scores places on one bench.

    Args:
        bench: The record under the causes so far.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._ladder = Ladder(bench.floor)
        self._rough = Ladder(bench.floor, _ROUGH)
        self._starts = bench.record.starts
        self._known: dict[str, Shapes] = {}
        self._gain_courses = {
            "correctors": self._rough.filtered(bench.currents, self._starts),
            "bpms": self._rough.filtered(bench.orbit, self._starts),
        }

    def candidates(self, kind: EffectKind) -> list[Candidate]:
        """Find the best places of one kind, best first; empty when nothing is gained."""
        found: list[Candidate] = []
        if isinstance(kind, PairKind):
            found = list(self._pairs(kind))
        elif getattr(kind, "periodic", False) and isinstance(kind, SourceKind):
            found = list(self._periodic(kind))
        elif kind.target == "ring" and isinstance(kind, RingKind | ActuatorKind):
            found = list(self._ring(kind))
        elif isinstance(kind, ActuatorKind | SensorKind | SourceKind):
            found = list(self._placed(kind))
        best: dict[tuple[tuple[int, ...], bool], Candidate] = {}
        for candidate in found:
            key = (candidate.cause.places, candidate.cause.onset > 0)
            if key not in best or candidate.gain > best[key].gain:
                best[key] = candidate
        ranked = sorted(best.values(), key=lambda c: c.gain - np.log(c.choices), reverse=True)
        return ranked[:_KEPT]

    def changes(self, kind: EffectKind, values: Values) -> Changes:
        """Tell how the prediction changes by every place at once."""
        bench, record = self._bench, self._bench.record
        if isinstance(kind, ActuatorKind):
            moved = kind.drive(bench.currents, values, record) - bench.currents
            return Changes(((self._shapes("correctors", lambda: record.layout.response), moved),))
        if isinstance(kind, SensorKind):
            # What is not small has taken the predicted orbit with it: take the model's own.
            small = bool(kind.parameters)
            orbit = bench.orbit if small else bench.currents @ record.layout.response.T
            moved = kind.distort(orbit, values, record) - orbit
            return Changes(((self._shapes("bpms", lambda: np.eye(moved.shape[1])), moved),))
        if isinstance(kind, SourceKind):
            patterns = kind.patterns(record.layout)
            drivers = kind.drivers(values, record, bench.currents, bench.orbit)
            if drivers.ndim == 2:
                return Changes(((self._shapes(kind.id, lambda: patterns), drivers),))
            parts: list[tuple[Shapes, Matrix]] = []
            for plane, driver in zip(("x", "y"), drivers, strict=True):
                rows = record.layout.bpms.in_plane(plane)
                if len(rows):
                    own = np.zeros_like(patterns)
                    own[rows] = patterns[rows]
                    shapes = self._shapes(f"{kind.id} {plane}", lambda own=own: own)
                    parts.append((shapes, driver))
            return Changes(tuple(parts))
        raise TypeError(f"{kind.id} has no places to scan")

    def _shapes(self, name: str, patterns: Callable[[], Matrix]) -> Shapes:
        """Patterns by name, prepared once."""
        if name not in self._known:
            own = patterns()
            self._known[name] = Shapes(
                own, self._bench.slope @ own, self._ladder.shapes(own), self._rough.shapes(own)
            )
        return self._known[name]

    def _placed(self, kind: ActuatorKind | SensorKind | SourceKind) -> Iterator[Candidate]:
        """Scan a grid of values for single places and for all; look closer at the best values."""
        closer: dict[str, tuple[float, Values, Changes]] = {}
        bench = self._bench
        grid = [*kind.grid(bench.record)]
        if isinstance(kind, ActuatorKind):
            shapes = self._shapes("correctors", lambda: bench.record.layout.response)
            grid += kind.hints(bench.currents, shapes.pull, bench.record)
        for values in grid:
            changes = self.changes(kind, values)
            steady = list(self._steady(kind, values, changes))
            yield from steady
            tried = {"single": max((c.gain for c in steady), default=0.0)}
            if kind.collective and isinstance(kind, ActuatorKind | SensorKind):
                tried["all"] = self._all(kind, changes)
                tried["cell"] = self._cell(kind, changes)
            for what, gain in tried.items():
                if what not in closer or gain > closer[what][0]:
                    closer[what] = (gain, values, changes)
        if "all" in closer:
            yield from self._groups(kind, *closer["all"][1:])
            if closer["cell"][1] is not closer["all"][1]:
                yield from self._groups(kind, *closer["cell"][1:])
        if kind.sudden and "single" in closer:
            yield from self._onsets(kind, *closer["single"][1:])

    def _cell(self, kind: ActuatorKind | SensorKind, changes: Changes) -> float:
        """Best gain, roughly, if every place of one cell were struck alike."""
        layout = self._bench.record.layout
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        score = self._score(changes)
        cells = list(devices.groups().values())
        sums = np.array([score[columns].sum() for columns in cells])
        if not len(sums) or (kind.linear is None and sums.max() < _WORTH):
            return 0.0
        info = self._information(kind, changes)[0]
        infos = np.array([info[columns].sum() for columns in cells])
        return float(_best_strength(kind, sums, infos)[1].max())

    def _all(self, kind: EffectKind, changes: Changes) -> float:
        """Gain if every place were struck alike."""
        (shapes, drivers), *_ = changes.parts
        if kind.linear is None and np.sum(shapes.pull * drivers) < _WORTH:
            return 0.0  # it cannot gain more than its score
        change = drivers @ shapes.patterns.T
        score = np.asarray(np.sum(self._bench.slope * change))[None]
        info = np.asarray(np.sum(self._bench.floor.whiten(change, self._starts) ** 2))[None]
        return float(_best_strength(kind, score, info)[1][0])

    def _courses(self, drivers: Matrix) -> list[Matrix]:
        return self._ladder.filtered(drivers, self._starts)

    def _information(self, kind: EffectKind, changes: Changes) -> tuple[Vector, Vector]:
        """Information on every place, and the share of it that the background takes away."""
        total: Vector = np.zeros(1)
        sizes: list[Vector] = []
        courses: list[Matrix] = []
        for shapes, drivers in changes.parts:
            sizes = [np.sum(shape**2, axis=0) for shape in shapes.rough]
            courses = self._rough.filtered(drivers, self._starts)
            for size, course in zip(sizes, courses, strict=True):
                total = total + size * np.einsum("kp,kp->p", course, course)
        if not isinstance(kind, ActuatorKind | SensorKind):
            return total, np.zeros_like(total)
        actuator = isinstance(kind, ActuatorKind)
        like = self._gain_courses["correctors" if actuator else "bpms"]
        both, own = np.zeros_like(total), np.zeros_like(total)
        for size, course, gain in zip(sizes, courses, like, strict=True):
            both += size * np.einsum("kp,kp->p", course, gain)
            own += size * np.einsum("kp,kp->p", gain, gain)
        alike = both**2 / np.maximum(total * own, 1e-300)
        absorbed = self._bench.background.absorbed("correctors" if actuator else "bpms")
        return total, np.clip(alike, 0.0, 1.0) * absorbed

    def _steady(self, kind: EffectKind, values: Values, changes: Changes) -> Iterator[Candidate]:
        score = self._score(changes)
        if kind.linear is None and score.max(initial=0.0) < _WORTH:
            return  # a change cannot gain more than its score
        info, absorbed = self._information(kind, changes)
        strength, gain = _best_strength(kind, score, info * (1.0 - absorbed))
        for place in np.argsort(gain)[::-1][:_KEPT]:
            if gain[place] > 0:
                yield Candidate(
                    Cause(kind, (int(place),), _sized(kind, values, float(strength[place]))),
                    float(gain[place]),
                    len(score),
                )

    def _score(self, changes: Changes) -> Vector:
        """Score of every place, shape (P,)."""
        total: Vector = np.zeros(1)
        for shapes, drivers in changes.parts:
            if drivers.shape[1] == 1:
                total = total + drivers[:, 0] @ shapes.pull
            else:
                total = total + np.einsum("kp,kp->p", shapes.pull, drivers)
        return total

    def _groups(self, kind: EffectKind, values: Values, changes: Changes) -> Iterator[Candidate]:
        """Try all devices, those of a plane, and every run of neighbouring cells."""
        layout = self._bench.record.layout
        devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
        score = self._score(changes)
        (shapes, drivers), *_ = changes.parts
        matrix = information(shapes.fine, self._courses(drivers))
        absorbed = self._information(kind, changes)[1]
        keep = np.sqrt(1.0 - absorbed)
        matrix *= np.outer(keep, keep)
        groups = list(groups_of(devices.groups(), len(devices), devices.planes))
        member = np.zeros((len(groups), len(devices)))
        for row, (_, columns) in enumerate(groups):
            member[row, columns] = 1.0
        info = np.einsum("gp,gp->g", member @ matrix, member)
        strength, gain = _best_strength(kind, member @ score, info)
        for group in np.argsort(gain)[::-1][:_KEPT]:
            if gain[group] > 0:
                name, members = groups[int(group)]
                sized = _sized(kind, values, float(strength[group]))
                yield Candidate(
                    Cause(kind, tuple(int(i) for i in members), sized),
                    float(gain[group]),
                    float(len(groups)),
                    name,
                )

    def _onsets(self, kind: EffectKind, values: Values, changes: Changes) -> Iterator[Candidate]:
        """Try every row as the beginning, place by place."""
        score = _sum(shapes.pull * drivers for shapes, drivers in changes.parts)
        later_score = np.cumsum(score[::-1], axis=0)[::-1]
        later = np.zeros_like(later_score)
        row = np.arange(len(score), dtype=np.float64)
        short = 1.0 / np.maximum(row, 1.0) + 1.0 / (len(row) - row)
        # What a corrector holds is what it had at the onset: there is no jump then.
        holds = isinstance(kind, ActuatorKind) and not kind.vanishes
        if holds:
            (shapes, drivers), *_ = changes.parts
            pull = np.cumsum(shapes.pull[::-1], axis=0)[::-1]
            later_score = later_score - pull * drivers
        for shapes, drivers in changes.parts:
            for shape, course, feedback in zip(
                shapes.fine,
                self._courses(drivers),
                self._ladder.feedback,
                strict=True,
            ):
                size = np.sum(shape**2, axis=0)
                later += size * np.cumsum((course**2)[::-1], axis=0)[::-1]
                if not holds:
                    # A step is seen against the rows before it that the filter remembers, by the
                    # rows after it until the filter has followed.
                    later += size * drivers**2 / (1.0 - feedback**2 + short)[:, None]
        strength, gain = _best_strength(kind, later_score, later)
        gain[:_FIRST_ONSET] = 0.0
        gain[len(gain) - _LAST_ONSET :] = 0.0
        best = np.argmax(gain, axis=0)
        height = gain[best, np.arange(gain.shape[1])]
        for place in np.argsort(height)[::-1][:_KEPT]:
            row = int(best[place])
            if height[place] > 0:
                sized = _sized(kind, values, float(strength[row, place]))
                yield Candidate(
                    Cause(kind, (int(place),), sized, row),
                    float(height[place]),
                    float(gain.size),
                )

    def _ring(self, kind: RingKind | ActuatorKind) -> Iterator[Candidate]:
        bench = self._bench
        for values in kind.grid(bench.record):
            if isinstance(kind, ActuatorKind):
                moved = kind.drive(bench.currents, values, bench.record) - bench.currents
                change = moved @ bench.record.layout.response.T
            else:
                change = kind.deflect(values, bench.record, bench.currents, bench.orbit)
            score = np.asarray(np.sum(bench.slope * change))[None]
            block = np.asarray(np.sum(bench.floor.whiten(change, self._starts) ** 2))[None]
            strength, gain = _best_strength(kind, score, block)
            if gain[0] > 0:
                sized = _sized(kind, values, float(strength[0]))
                yield Candidate(Cause(kind, (), sized), float(gain[0]), 1.0)
            if kind.sudden and not kind.grows:
                yield from self._ring_onset(kind, values, change)

    def _ring_onset(
        self, kind: RingKind | ActuatorKind, values: Values, change: Matrix
    ) -> Iterator[Candidate]:
        """Try every row as the beginning of an effect on the whole ring."""
        rows = len(change)
        score = np.cumsum(np.sum(self._bench.slope * change, axis=1)[::-1])[::-1]
        tried = np.linspace(0.1, 0.9, _ONSETS_TRIED) * rows
        info = [self._information_from(change, int(row)) for row in tried]
        strength, gain = _best_strength(kind, score, np.interp(np.arange(rows), tried, info))
        gain[:_FIRST_ONSET] = 0.0
        gain[rows - _LAST_ONSET :] = 0.0
        best = int(np.argmax(gain))
        if gain[best] > 0:
            sized = _sized(kind, values, float(strength[best]))
            yield Candidate(Cause(kind, (), sized, best), float(gain[best]), float(rows))

    def _information_from(self, change: Matrix, row: int) -> float:
        later = change.copy()
        later[:row] = 0.0
        return float(np.sum(self._bench.floor.whiten(later, self._starts) ** 2))

    def _periodic(self, kind: SourceKind) -> Iterator[Candidate]:
        """Find the line of one source: the Fourier transform of its score has all frequencies."""
        bench, record = self._bench, self._bench.record
        longest = max(record.stretches, key=lambda part: part.stop - part.start)
        rows = longest.stop - longest.start
        patterns = kind.patterns(record.layout)
        padded = _FINER * rows
        score = np.fft.rfft(bench.slope[longest] @ patterns, padded, axis=0)
        frequency = np.fft.rfftfreq(padded)
        feedback = 1.0 - bench.floor.gains
        turn = np.exp(-2j * np.pi * frequency)[:, None]
        response = np.abs((1.0 - turn) / (1.0 - feedback * turn)) ** 2
        weight = response / bench.floor.innovation_variance
        info = weight @ (bench.floor.modes.T @ patterns) ** 2 * (rows / 2.0)
        info[: 2 * _FINER] = np.inf  # fewer than two periods are a drift
        gain = 0.5 * np.abs(score) ** 2 / info
        best = np.argpartition(gain, -_KEPT, axis=None)[-_KEPT:]
        for flat in best:
            line, place = np.unravel_index(int(flat), gain.shape)
            size = score[line, place] / info[line, place]
            angle = 2 * np.pi * frequency[line] * longest.start
            size *= np.exp(1j * angle)  # the course is counted from the first row of the record
            yield Candidate(
                Cause(
                    kind,
                    (int(place),),
                    {
                        "frequency": float(frequency[line] / record.layout.period),
                        "cosine": float(size.real),
                        "sine": float(-size.imag),
                    },
                ),
                float(gain[line, place]),
                float(gain.size) / _FINER,
            )

    def _pairs(self, kind: PairKind) -> Iterator[Candidate]:
        bench, record = self._bench, self._bench.record
        pairs = kind.pairs(record.layout)
        if not len(pairs):
            return
        if kind.target == "corrector":
            patterns, drivers = record.layout.response, bench.currents
        else:
            patterns, drivers = np.eye(bench.orbit.shape[1]), bench.orbit
        scores = (bench.slope @ patterns).T @ drivers
        shapes, courses = self._ladder.shapes(patterns), self._courses(drivers)
        overlap = [(s.T @ s, c.T @ c) for s, c in zip(shapes, courses, strict=True)]
        for values in kind.grid(record):
            change = kind.matrices(record.layout, values) - np.eye(2)
            score = np.zeros(len(pairs))
            info = np.zeros(len(pairs))
            for a, b in np.ndindex(2, 2):
                score += change[:, a, b] * scores[pairs[:, a], pairs[:, b]]
                for c, d in np.ndindex(2, 2):
                    factor = change[:, a, b] * change[:, c, d]
                    if np.any(factor):
                        for shape, course in overlap:
                            info += (
                                factor
                                * shape[pairs[:, a], pairs[:, c]]
                                * course[pairs[:, b], pairs[:, d]]
                            )
            strength, gain = _best_strength(kind, score, info)
            for place in np.argsort(gain)[::-1][:_KEPT]:
                if gain[place] > 0:
                    yield Candidate(
                        Cause(kind, (int(place),), _sized(kind, values, float(strength[place]))),
                        float(gain[place]),
                        float(len(pairs)),
                    )


def groups_of(
    cells: Mapping[str, Indices], count: int, planes: Sequence[str]
) -> Iterator[tuple[str, Indices]]:
    """List groups that an effect may strike: all, a plane, runs of neighbouring cells.

    Args:
        cells: Columns of every cell, in order around the ring.
        count: Of all columns.
        planes: Of every column.
    """
    everything = np.arange(count, dtype=np.intp)
    yield "all", everything
    of_plane = {p: everything[np.array([q == p for q in planes])] for p in sorted(set(planes))}
    if len(of_plane) > 1:
        yield from ((f"all {plane}", members) for plane, members in of_plane.items())
    names = list(cells)
    for begin in range(len(names)):
        for end in range(begin + 1, min(begin + 1 + len(names) // 2, len(names) + 1)):
            members = np.concatenate([cells[name] for name in names[begin:end]])
            if len(members) < 2:
                continue
            label = names[begin] if end == begin + 1 else f"{names[begin]}–{names[end - 1]}"
            yield label, members
            if len(of_plane) > 1:
                for plane in of_plane:
                    own = members[np.array([planes[int(i)] == plane for i in members])]
                    if len(own) > 1:
                        yield f"{label} {plane}", own


def _best_strength(kind: EffectKind, score: Vector, info: Vector) -> tuple[Vector, Vector]:
    """Best strength and its gain, of every place.

    Where the change is linear in the parameter any strength will do; where it is not the change
    itself is at stake, and the grid has others.
    """
    seen = info > _LEAST_INFORMATION
    strength = np.divide(score, info, out=np.zeros_like(score), where=seen)
    if kind.linear is None:
        strength = np.ones_like(strength)
    return strength, np.where(seen, strength * score - 0.5 * strength**2 * info, 0.0)


def _sized(kind: EffectKind, values: Values, strength: float) -> Values:
    """Parameters at which the change is `strength` times that at `values`."""
    if kind.linear is None:
        return values
    spec = next(p for p in kind.parameters if p.name == kind.linear)
    value = spec.nominal + float(strength) * (values[kind.linear] - spec.nominal)
    return {**values, kind.linear: float(np.clip(value, spec.low, spec.high))}


def _sum(terms: Iterator[Matrix]) -> Matrix:
    total = next(terms)
    for term in terms:
        total = total + term
    return total

"""Courses of a candidate near other values: to seek better ones, and to leave them free.

Causes that were accepted stay free: the values of every device may differ a little.

To first order another value θ (1 + δ) of a device adds δ · θ ∂course/∂θ to what it does. These
columns join the healthy errors: the scatter of δ is a variance component of its own, and whatever
is tried later is weighed with all δ marginalised (a joint refit).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import FIRST_STATE, EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.estimation.priors import OWN_REACH, SLOPE
from orbitfb.estimation.transform import Indices, Matrix, StepTransform


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Where the courses of a candidate come from.

    Args:
        law: Of its devices.
        places: Devices; empty: all.
        values: Of the parameters, as found for all devices together.
        size: By which the courses are multiplied, of every device, shape (k,).
        onset: Row at which it begins.
        kick: Whether what it has reached by then comes at once, where the law does not know.
        first: State of every device in the first row, from −1 to 1, shape (k,), of a law that
            remembers; None: in the middle.
        own: Factors by which values of every device differ from those, shape (k,), by parameter; of
            a law that takes values of every device's own.
        elements: Errors of single elements of the response, by the name of what they are with
            [m/A]; empty of a law that has none.
    """

    law: DeviceLaw
    places: tuple[int, ...]
    values: Values
    size: Vector
    onset: int = 0
    kick: bool = False
    first: Vector | None = None
    own: Mapping[str, Vector] = field(default_factory=dict)
    elements: Mapping[str, float] = field(default_factory=dict)

    def of(self, signals: Signals, values: Values) -> tuple[Matrix, ...]:
        """Courses of the devices for given values, nothing before the onset, (N, k) or (N, 1)."""
        signals, values, chosen = self._struck(signals, values)
        begins = self.onset if self.law.fresh else 0
        reached = None
        if self.onset and not begins and self.law.first is not None:
            reached = self.law.first(values, signals)[self.onset, chosen]
        found = []
        for course in self.law.course(values, signals.since(begins)):
            part = course if course.shape[1] == 1 else course[:, chosen]
            if begins:
                part = np.pad(part, ((begins, 0), (0, 0)))
            elif self.onset:
                base = based(part, self.onset, self.kick, reached)
                part = np.where((np.arange(len(part)) >= self.onset)[:, None], part - base, 0.0)
            found.append(part)
        return tuple(found)

    def added(self, signals: Signals) -> Matrix:
        """What its devices add to the readings, shape (N, n) [m]."""
        chosen, total = list(self.places) if self.places else slice(None), 0.0
        for block, course in zip(self.law.patterns, self.of(signals, self.values), strict=True):
            total = total + (course * self.size) @ block[:, chosen].T
        return np.asarray(total)

    def lacks(self, kind: EffectKind, signals: Signals) -> str:
        """What the record does not show of the law that makes it this one; empty: nothing."""
        if self.law.lacks is None:
            return ""
        signals, values, _ = self._struck(signals, self.values)
        scaled = {p.name: self.size * values[p.name] for p in kind.sizes}
        return self.law.lacks(cast(Values, {**values, **scaled}), signals, self.onset)

    def _struck(
        self, signals: Signals, values: Values
    ) -> tuple[Signals, Values, slice | list[int]]:
        """Signals and values of its devices, if the law can be told of these alone, or of all.

        Returns:
            Signals, values, and the columns of the courses that are its devices.
        """
        own, state = dict(self.own), self.first
        chosen: slice | list[int] = slice(None)
        if self.law.some is not None and self.places:
            signals = self.law.some(signals, np.array(self.places))
        else:
            chosen = list(self.places) if self.places else slice(None)
            own = {name: self._every(1.0, mine) for name, mine in own.items()}
            state = None if state is None else self._every(0.0, state)
        each = {name: values[name] * factor for name, factor in own.items()}
        if state is not None:
            each[FIRST_STATE] = state
        return signals, cast(Values, {**values, **each}), chosen

    def _every(self, others: float, mine: Vector) -> Vector:
        """Numbers of all devices of the law, shape (D,): of those of the course, and of others."""
        every = np.full(len(self.law.names), others)
        every[list(self.places) if self.places else slice(None)] = mine
        return every

    def undone(
        self, kind: EffectKind, signals: Signals
    ) -> Iterator[tuple[Indices, Matrix, Vector]]:
        """Devices (k,), what undoing them takes off their readings (N, k) [m], log factor (N,)."""
        undone = self.law.undone
        if undone is None:
            return
        places = self.places or tuple(range(len(self.law.names)))
        every = np.array(places, dtype=np.intp)
        late = np.arange(len(signals.record)) >= self.onset
        for size in np.unique(self.size):
            scaled = {p.name: float(size) * self.values[p.name] for p in kind.sizes}
            columns = every[self.size == size]
            change, wider = undone({**self.values, **scaled}, signals, columns)
            yield columns, np.where(late[:, None], change, 0.0), np.where(late, wider, 0.0)

    def columns(self, kind: EffectKind, signals: Signals) -> Iterator[tuple[str, Matrix, Matrix]]:
        """Parameter, patterns (n, k), courses (N, k) of a relative change of each by 1."""
        now = self.of(signals, self.values)
        scaled = {parameter.name for parameter in kind.sizes}
        fitted = {parameter.name for parameter in kind.fitted(signals.record)}
        if len(scaled) == 1:
            yield from self._along(next(iter(scaled)), now)
            fitted -= scaled
        for parameter in kind.parameters:
            value = self.values.get(parameter.name, 0.0)
            free = parameter.name in fitted and not parameter.meanings
            if not free or parameter.whole or value == 0.0:
                continue
            yield from self._slope(parameter.name, value, now, signals)

    def unset(
        self, kind: EffectKind, signals: Signals, most: Values
    ) -> Iterator[tuple[str, Matrix, Matrix]]:
        """The same of each of its sizes that is zero, as it would be the most that is thinkable.

        Args:
            kind: The effect.
            signals: On which it acts.
            most: Such sizes.
        """
        now = self.of(signals, self.values)
        for name, value in most.items():
            if self.values[name] == 0.0:
                yield from self._slope(name, value, now, signals)

    def _slope(
        self, name: str, unit: float, now: Sequence[Matrix], signals: Signals
    ) -> Iterator[tuple[str, Matrix, Matrix]]:
        """What a value that grows by a unit changes."""
        moved = self.of(signals, {**self.values, name: self.values[name] + SLOPE * unit})
        slope = [(new - old) / SLOPE for new, old in zip(moved, now, strict=True)]
        yield from self._along(name, slope)

    def _along(self, name: str, courses: Sequence[Matrix]) -> Iterator[tuple[str, Matrix, Matrix]]:
        """Courses beside their patterns, block by block, where there are any."""
        chosen = list(self.places) if self.places else slice(None)
        for block, course in zip(self.law.patterns, courses, strict=True):
            pattern = block[:, chosen]
            if np.any(pattern) and np.any(course):
                wide = np.broadcast_to(course, (len(course), pattern.shape[1]))
                yield name, pattern, wide * self.size


def summed(
    columns: Iterable[tuple[str, Matrix, Matrix]], transform: StepTransform
) -> dict[str, Matrix]:
    """What columns add together: spectra (T, n) [m], by parameter."""
    found: dict[str, Matrix] = {}
    for name, patterns, courses in columns:
        added = transform.spectrum(courses) @ patterns.T
        found[name] = found[name] + added if name in found else added
    return found


def based(course: Matrix, onset: int, kick: bool, reached: Vector | None) -> Vector:
    """What is taken off courses that begin at a row, shape (k,).

    Args:
        course: Over the whole record, shape (N, k).
        onset: The row.
        kick: Whether what they have reached since the first row comes at once, or none of it.
        reached: What comes at once, shape (k,), where the law knows; None: as `kick` says.
    """
    if reached is not None:
        return np.asarray(course[onset] - reached)
    return np.asarray(course[0] if kick else course[onset])


def joined(parts: list[tuple[str, Matrix, Matrix]]) -> tuple[Matrix, Indices, Matrix]:
    """Columns of several parts: patterns (n, P), their numbers (P,), courses (N, P)."""
    patterns = np.hstack([pattern for _, pattern, _ in parts])
    return patterns, np.arange(patterns.shape[1]), np.hstack([course for _, _, course in parts])


def spectrum_of(sources: Sequence[Course], scorer: Scorer) -> tuple[Single, list[Matrix]]:
    """Spectra of courses of one device each, (T, blocks · k), and their patterns, (n, k) each."""
    signals, law = scorer.space.signals, sources[0].law
    chosen = [one.places[0] for one in sources]
    several = [one.of(signals, one.values) for one in sources]
    whole = np.hstack([each[block] for block in range(len(law.patterns)) for each in several])
    patterns = [np.asarray(block[:, chosen]) for block in law.patterns]
    return scorer.space.transform.quick_spectrum(whole), patterns


def moved(sources: Sequence[Course], name: str, step: Vector) -> list[Course]:
    """The same with other values: their logarithms have moved by a step, shape (k,)."""
    told: Vector = np.array([one.values.get(name, 0.0) for one in sources]) * np.exp(step)
    return [
        replace(one, values={**one.values, name: value})
        for one, value in zip(sources, told.tolist(), strict=True)
    ]


def step_of(sources: Sequence[Course], name: str, scorer: Scorer) -> tuple[Vector, float]:
    """A step of Gauss and Newton towards better values of all, beside the healthy errors.

    Args:
        sources: Of one device each, with values and sizes.
        name: Of the value.
        scorer: Of what is left to explain.

    Returns:
        Of the logarithms, shape (k,), and what it would gain if courses followed them [nats].
    """
    count, slope = len(sources), np.full(len(sources), SLOPE)
    now, patterns = spectrum_of(sources, scorer)
    up, down = (spectrum_of(moved(sources, name, one), scorer)[0] for one in (slope, -slope))
    sizes = np.tile(np.concatenate([one.size for one in sources]), len(patterns))
    slopes = (up - down) / (2.0 * SLOPE)
    both = np.hstack([slopes * sizes, now * sizes]).astype(np.float32)
    pull, information = scorer.columns(patterns, both)
    left = pull[:count] - information[:count, count:].sum(axis=1)
    inner = information[:count, :count] + np.eye(count) / OWN_REACH**2
    step = np.linalg.solve(inner, left)
    step *= OWN_REACH / max(OWN_REACH, float(np.max(np.abs(step))))
    return step, float(step @ left - 0.5 * step @ inner @ step)

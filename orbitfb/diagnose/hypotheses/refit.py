"""Causes that were accepted stay free: the values of every device may differ a little.

To first order another value θ (1 + δ) of a device adds δ · θ ∂course/∂θ to what it does. These
columns join the healthy errors: the scatter of δ is a variance component of its own, and whatever
is tried later is weighed with all δ marginalised (a joint refit).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import FIRST_STATE, EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, Signals
from orbitfb.estimation.transform import Indices, Matrix

_STEP = 0.02
"""Step of a value by which its derivative is taken, of the value [1]."""


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
        chosen = list(self.places) if self.places else slice(None)
        each = {name: values[name] * self._every(1.0, own) for name, own in self.own.items()}
        if self.first is not None:
            each[FIRST_STATE] = self._every(0.0, self.first)
        values = cast(Values, {**values, **each})
        found, reached = [], None
        if self.onset and self.law.first is not None:
            reached = self.law.first(values, signals)[self.onset, chosen]
        for course in self.law.course(values, signals):
            part = course if course.shape[1] == 1 else course[:, chosen]
            if self.onset:
                base = based(part, self.onset, self.kick, reached)
                part = np.where((np.arange(len(part)) >= self.onset)[:, None], part - base, 0.0)
            found.append(part)
        return tuple(found)

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
        chosen = list(self.places) if self.places else slice(None)
        now = self.of(signals, self.values)
        scaled = {parameter.name for parameter in kind.sizes}
        changes: list[tuple[str, tuple[Matrix, ...]]] = []
        if scaled:
            changes.append((next(iter(sorted(scaled))), now))
        for parameter in kind.parameters:
            value = self.values.get(parameter.name, 0.0)
            free = parameter in kind.fitted(signals.record) and not parameter.meanings
            if parameter.name in scaled or not free or parameter.whole or value == 0.0:
                continue
            moved = self.of(signals, {**self.values, parameter.name: value * (1.0 + _STEP)})
            slope = tuple((new - old) / _STEP for new, old in zip(moved, now, strict=True))
            changes.append((parameter.name, slope))
        for name, change in changes:
            for block, course in zip(self.law.patterns, change, strict=True):
                pattern = block[:, chosen]
                if np.any(pattern) and np.any(course):
                    wide = np.broadcast_to(course, (len(course), pattern.shape[1]))
                    yield name, pattern, wide * self.size


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

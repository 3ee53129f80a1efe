"""What a suspected effect would do in another record than the one that raised the suspicion."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.hypotheses.refit import Course, summed
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw, PairLaw, Signals
from orbitfb.estimation.transform import Matrix, StepTransform

_STEP = 0.02
"""Step of a value by which its derivative is taken, of the value [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class Suspect:
    """An effect at places with values.

    Args:
        kind: The effect.
        places: Devices or places that are struck; empty: the ring, or all of them.
        values: Of the parameters, SI.
        sizes: Of every place, where each has its own, in units of the linear parameter.
        sources: Courses of its devices, where a search has left them.
        parts: What it consists of, where several were found at once.
    """

    kind: EffectKind
    places: tuple[int, ...]
    values: Values
    sizes: tuple[float, ...] = ()
    sources: tuple[Course, ...] = ()
    parts: "tuple[Suspect, ...]" = ()

    @classmethod
    def of(cls, candidate: Candidate) -> "Suspect":
        """Take what a tournament found for something that is there all the time."""
        sources = tuple(replace(one, onset=0) for one in candidate.sources)
        parts = tuple(cls.of(one) for one in candidate.parts)
        return cls(
            candidate.kind, candidate.places, candidate.values, candidate.sizes, sources, parts
        )  # fmt: skip

    @classmethod
    def typical(cls, kind: EffectKind, signals: Signals) -> "Suspect":
        """An effect of typical size at a place in the middle, when a record shows none."""
        values = {parameter.name: parameter.typical for parameter in kind.parameters}
        places: tuple[int, ...] = ()
        for law in kind.laws(signals):
            if isinstance(law, PairLaw) and len(law.pairs):
                places = law.struck[len(law.pairs) // 2]
            elif isinstance(law, DeviceLaw):
                places = (len(law.names) // 2,)
        return cls(kind, places, values)


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What a suspect adds to the readings, told by the spectrum of its steps.

    Args:
        field: Shape (T, n) [m].
        free: By how much the field changes with a relative change of each of its values by 1; a
            record that is yet to come has other best values.
    """

    field: Matrix
    free: tuple[Matrix, ...]


def change_of(suspect: Suspect, signals: Signals, transform: StepTransform) -> Change | None:
    """Predict what a suspect adds to a record.

    None of what is random, strikes unknown rows, or is of no pair that the ring has.
    """
    if suspect.sources:
        return _of_courses(suspect.kind, suspect.sources, signals, transform)
    if suspect.parts:
        changes = [change_of(one, signals, transform) for one in suspect.parts]
        known = [one for one in changes if one is not None]
        if len(known) < len(changes):
            return None
        free = tuple(own for one in known for own in one.free)
        return Change(np.sum([one.field for one in known], axis=0), free)
    for law in suspect.kind.laws(signals):
        if isinstance(law, DeviceLaw):
            course = Course(law, suspect.places, suspect.values, _sizes(suspect, law))
            return _of_courses(suspect.kind, (course,), signals, transform)
        if isinstance(law, PairLaw):
            number = _pair(law, suspect.places)
            if number is None:
                return None
            return _moved(suspect, transform, _PairField(law, number))
        if isinstance(law, FieldLaw):
            return _moved(suspect, transform, _RingField(law, signals))
    return None


def _sizes(suspect: Suspect, law: DeviceLaw) -> Vector:
    """By how much each device has the course of the values, shape (k,)."""
    count = len(suspect.places) or len(law.names)
    linear = suspect.kind.linear
    if suspect.sizes and linear and suspect.values[linear]:
        return np.array(suspect.sizes) / suspect.values[linear]
    return np.ones(count)


def _of_courses(
    kind: EffectKind, sources: tuple[Course, ...], signals: Signals, transform: StepTransform
) -> Change:
    """Devices with courses of their own."""
    field = transform.spectrum(np.sum([one.added(signals) for one in sources], axis=0))
    free = summed((column for one in sources for column in one.columns(kind, signals)), transform)
    return Change(field, tuple(free.values()))


def _pair(law: PairLaw, struck: tuple[int, ...]) -> int | None:
    """Number of the pair at which these columns are at fault; None: there is none."""
    return next((number for number, its in enumerate(law.struck) if its == struck), None)


@dataclass(frozen=True, slots=True, eq=False)
class _PairField:
    """Courses that a pair of columns exchanges."""

    law: PairLaw
    number: int

    def __call__(self, values: Values) -> Matrix:
        pair = self.law.pairs[self.number]
        mixing = self.law.mixing(values)[self.number]
        return (self.law.courses[:, pair] @ mixing.T) @ self.law.patterns[:, pair].T


@dataclass(frozen=True, slots=True, eq=False)
class _RingField:
    """An orbit course of the whole ring."""

    law: FieldLaw
    signals: Signals

    def __call__(self, values: Values) -> Matrix:
        return self.law.course(values, self.signals)


def _moved(suspect: Suspect, transform: StepTransform, course: "_PairField | _RingField") -> Change:
    """A field of values, and how it moves with each of them."""
    now = transform.spectrum(course(suspect.values))
    free: list[Matrix] = []
    for parameter in suspect.kind.parameters:
        value = suspect.values.get(parameter.name, 0.0)
        if parameter.meanings or parameter.whole or value == 0.0:
            continue
        moved: Mapping[str, float] = {**suspect.values, parameter.name: value * (1.0 + _STEP)}
        free.append((transform.spectrum(course(moved)) - now) / _STEP)
    return Change(now, tuple(one for one in free if np.any(one)))

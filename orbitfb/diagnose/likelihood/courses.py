"""Courses of laws, computed once: accepted causes change the floor, not what a law would do."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.effects.kinds import EffectKind, OwnValues, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw, Law, Signals
from orbitfb.estimation.transform import StepTransform

MOST_KEPT = 1 << 30
"""Bytes of spectra that are kept [B]: 480 courses of 180 devices and 3,000 rows. What does not fit
is computed again in every round, which costs time and changes nothing."""

TOGETHER = 8
"""Sets of values whose courses are computed together: a row of 8 · 180 numbers costs a numpy call
as much time for its numbers as for being called."""

_Key = tuple[int, tuple[tuple[str, float | bytes], ...]]


@dataclass(slots=True, eq=False)
class Courses:
    """The laws of effects on one record, and the spectra of their courses.

    Args:
        signals: What the laws act on.
        transform: Of the record.
    """

    signals: Signals
    transform: StepTransform
    _laws: dict[str, Sequence[Law]] = field(default_factory=dict)
    _grids: dict[str, Sequence[Values]] = field(default_factory=dict)
    _spectra: dict[_Key, tuple[Single, ...]] = field(default_factory=dict)
    _powers: dict[tuple[_Key, int | None], tuple[Single, ...]] = field(default_factory=dict)
    _bytes: int = 0

    def hearing(self, signals: Signals) -> "Courses":
        """The same for another predicted orbit: what follows from the setpoints alone is kept."""
        kept = Courses(signals, self.transform, self._laws, self._grids)
        driven = {
            id(law)
            for laws in self._laws.values()
            for law in laws
            if isinstance(law, DeviceLaw) and law.driven
        }
        for key, spectra in self._spectra.items():
            if key[0] in driven:
                kept._keep(key, spectra)
        kept._powers.update((key, its) for key, its in self._powers.items() if key[0][0] in driven)
        return kept

    def laws(self, kind: EffectKind) -> Sequence[Law]:
        """The laws of an effect."""
        if kind.id not in self._laws:
            self._laws[kind.id] = tuple(kind.laws(self.signals))
        return self._laws[kind.id]

    def grid(self, kind: EffectKind) -> Sequence[Values]:
        """The values of an effect that are scanned."""
        if kind.id not in self._grids:
            self._grids[kind.id] = tuple(kind.grid(self.signals.record))
        return self._grids[kind.id]

    def largest(self, kind: EffectKind) -> Values:
        """The largest of each of its sizes that is scanned."""
        grid = self.grid(kind)
        return {one.name: max(abs(values[one.name]) for values in grid) for one in kind.sizes}

    def spectra(self, law: DeviceLaw, values: OwnValues) -> tuple[Single, ...]:
        """Transformed steps of a law's courses, a block per block, (T, D) or (T, 1) each.

        Args:
            law: One of `laws`.
            values: Of its parameters.
        """
        key = _key(law, values)
        known = self._spectra.get(key)
        if known is None:
            courses = law.course(cast(Values, values), self.signals)
            known = tuple(self.transform.quick_spectrum(course) for course in courses)
            self._keep(key, known)
        return known

    def powers(
        self, law: DeviceLaw, values: OwnValues, beside: tuple[int, Single] | None = None
    ) -> tuple[Single, ...]:
        """Products of a law's courses with themselves, or with others, summed by band.

        Args:
            law: One of `laws`.
            values: Of its parameters.
            beside: A number that tells other courses from others still, and their transformed
                steps, shape (T, D).

        Returns:
            A block per block, shape (B, D) each, or (B, 1).
        """
        key = (_key(law, values), beside[0] if beside else None)
        known = self._powers.get(key)
        if known is None:
            known = tuple(
                self.transform.by_band(one * (one if beside is None else beside[1]))
                for one in self.spectra(law, values)
            )
            self._powers[key] = known
        return known

    def field(self, law: FieldLaw, values: Values) -> Single:
        """Transformed steps of the orbit of a law of the whole ring, shape (T, n) [m].

        Args:
            law: One of `laws`.
            values: Of its parameters.
        """
        key = _key(law, values)
        known = self._spectra.get(key)
        if known is None:
            known = (self.transform.quick_spectrum(law.course(values, self.signals)),)
            self._keep(key, known)
        return known[0]

    def ahead(self, law: DeviceLaw, sets: Sequence[Values]) -> None:
        """Compute the courses of several sets of values together, where that is quicker."""
        left = [one for one in sets if _key(law, one) not in self._spectra]
        if law.many is None:
            return
        devices = law.patterns[0].shape[1]
        size = 4 * len(self.transform) * devices
        left = left[: (MOST_KEPT - self._bytes) // size]
        for first in range(0, len(left), TOGETHER):
            some = left[first : first + TOGETHER]
            courses = law.many(some, self.signals)
            for number, values in enumerate(some):
                course = courses[:, number * devices : (number + 1) * devices]
                self._keep(_key(law, values), (self.transform.quick_spectrum(course),))

    def _keep(self, key: _Key, spectra: tuple[Single, ...]) -> None:
        size = sum(one.nbytes for one in spectra)
        if self._bytes + size <= MOST_KEPT:
            self._spectra[key] = spectra
            self._bytes += size


def _key(law: DeviceLaw | FieldLaw, values: OwnValues) -> _Key:
    told = ((name, _plain(value)) for name, value in values.items())
    return (id(law), tuple(sorted(told)))


def _plain(value: float | Vector) -> float | bytes:
    return value.tobytes() if isinstance(value, np.ndarray) else value

"""Effects that add an orbit of their own: fixed shapes with a course in time, or the whole ring."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import EffectKind, Values
from orbitfb.effects.laws import DeviceLaw, FieldLaw, Law, Signals, blocks, of_planes
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

Courses = NDArray[np.float64]
"""Courses in time of P places: (N, P), (N, 1), or by plane (2, N, P)."""


class SourceKind(EffectKind):
    """An effect that adds, for each of its places, an orbit of fixed shape times a course in time.

    Errors of quadrupoles, kicks, periodic disturbances, energy: everything of rank one per plane.
    A place that acts in both planes has one course for the rows of the x BPMs and one for those
    of the y BPMs (a gradient error acts with opposite signs): `orbitfb.effects.change` joins them.
    """

    target = "source"
    periodic: ClassVar[bool] = False
    """Whether it is `cosine` cos ωt + `sine` sin ωt of a `frequency` [Hz]: all frequencies are
    then scanned at once by a Fourier transform of the scores."""
    standing: ClassVar[bool] = False
    """Whether it kicks by an orbit of which the record tells only the changes: where it begins in
    the middle of a record its first kick is free."""

    @abstractmethod
    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Names of the P places that it may have (with the plane where that matters)."""

    def families(self, layout: Layout) -> dict[str, Indices]:
        """Sets of places that it may strike together, by name; none as a rule."""
        return {}

    def shares(self, layout: Layout, places: Indices) -> Vector:
        """How much of the effect each of k places has that it strikes together, shape (k,)."""
        return np.ones(len(places))

    @abstractmethod
    def patterns(self, layout: Layout) -> Matrix:
        """Orbit shape of every place, shape (n, P); of a place in both planes, both are filled."""

    @abstractmethod
    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Course of every place's amplitude.

        Args:
            values: All parameters.
            record: Time, period, auxiliary channels.
            currents: That act on the beam, shape (N, m) [A].
            orbit: Predicted orbit at the BPMs, without noise of the readings, shape (N, n) [m].

        Returns:
            Shape (N, P), or (N, 1) when it is the same for all places; or (2, N, P) when the
            planes differ: the first for the rows of the x BPMs, the second for those of y.
        """

    def laws(self, signals: Signals) -> Sequence[Law]:
        """An orbit of fixed shape for every place, with its course."""
        layout = signals.record.layout
        small = {p.name: p.typical for p in self.parameters}
        first = self.drivers(small, signals.record, signals.currents, signals.orbit)
        patterns = of_planes(self.patterns(layout), layout.bpms.planes, first.ndim == 3)

        def course(values: Values, given: Signals) -> tuple[Matrix, ...]:
            return blocks(self.drivers(values, given.record, given.currents, given.orbit))

        names = self.places_of(layout)
        families = self.families(layout)
        return (
            DeviceLaw(
                patterns, course, names, families, periodic=self.periodic, standing=self.standing
            ),
        )

    def drivers_at(
        self, places: Indices, values: Values, record: Record, currents: Matrix, orbit: Matrix
    ) -> Courses:
        """Courses of k places alone, shape (N, k), (N, 1) or (2, N, k); as `drivers`."""
        courses = self.drivers(values, record, currents, orbit)
        return courses if courses.shape[-1] == 1 else courses[..., places]


class RingKind(EffectKind):
    """An effect on the whole ring: it has no place."""

    target = "ring"
    collective = False

    def laws(self, signals: Signals) -> Sequence[Law]:
        """The orbit that it adds."""

        def course(values: Values, given: Signals) -> Matrix:
            return self.deflect(values, given.record, given.currents, given.orbit)

        return (FieldLaw(course),)

    @abstractmethod
    def deflect(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Tell what it adds to the orbit, shape (N, n) [m]; arguments as for `drivers`."""

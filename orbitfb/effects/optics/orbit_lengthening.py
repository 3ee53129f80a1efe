"""An orbit that is longer for being bent: the energy falls with its square."""

from functools import lru_cache

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import needs_ring
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, angles_around
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class OrbitLengthening(SourceKind):
    """x += η δ, δ in proportion to the square of the orbit's angles."""

    id = "orbit-lengthening"
    stage = "optics"
    target = "ring"
    parameters = (
        Parameter(
            "share",
            "1",
            -20.0,
            20.0,
            0.0,
            1.0,
            "Share of the lengthening that acts; 1 in a ring whose frequency is fixed.",
        ),
    )
    title = "energy that falls with the square of the orbit"
    sentence = (
        "A large orbit changes the energy by more than its own path length makes. Compare the "
        "momentum compaction of the configuration with the model."
    )
    equation = "x += η δ, δ = −share · ½ ∮ (x′² + y′²) ds / (α_c C), horizontal only"
    linear = "share"
    confused_with = ("sextupole", "energy-drift")
    splits = "Two amplitudes of the same excitation; the dispersion is its only pattern."
    collective = False
    sudden = False

    def unavailable(self, record: Record) -> str:
        """It needs the dispersion, and the horizontal plane."""
        return needs_ring(record, ("x",))

    def healthy_scatter(self, layout: Layout) -> Vector | None:
        """The whole of it: it acts in every ring, and no linear model has it."""
        return None if layout.ring is None or "x" not in layout.planes else np.ones(1)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Lengthen the orbit of the currents tick by tick."""
        return _Lengthened(layout, values["share"])

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """One, the energy."""
        return ("energy",)

    def patterns(self, layout: Layout) -> Matrix:
        """Its orbit, the dispersion."""
        return layout.dispersion()[:, None]

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Matrix:
        """Energy by what the currents have moved the beam since the record began.

        The response is that around the orbit then; what else moves the beam moves it less.
        """
        return values["share"] * _energy(record.layout, currents - currents[:1])[:, None]


@lru_cache(maxsize=8)
def _angles(layout: Layout) -> Matrix:
    """Angles per ampere between all places of the table, plane by plane, (k, m) [m^½/A]."""
    ring = layout.known_ring
    around = float(ring.parameters.circumference)
    s, places = np.unique(ring.table.s, return_index=True)
    planes = [angles_around(s, layout.orbit_at(places, one), around) for one in layout.planes]
    return np.vstack(planes)


def _energy(layout: Layout, currents: Matrix) -> Vector:
    """Relative energy by the lengthening of the orbits of currents, (N, m) [A], shape (N,) [1]."""
    ring = layout.known_ring
    length = 0.5 * np.sum((currents @ _angles(layout).T) ** 2, axis=1)
    return -length / (ring.parameters.alpha_c * ring.parameters.circumference)


class _Lengthened(Effect):
    def __init__(self, layout: Layout, share: float) -> None:
        self._layout, self._shape = layout, share * layout.dispersion()
        self._currents = np.zeros(len(layout.correctors))

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        self._currents = setpoints
        return setpoints

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        return orbit + float(_energy(self._layout, self._currents[None])[0]) * self._shape

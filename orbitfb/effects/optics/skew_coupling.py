"""A quadrupole that is rolled and couples the planes."""

import numpy as np

from orbitfb.effects.kicks import needs_ring, two_planes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.optics.gradients import PLANES
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class SkewCoupling(SourceKind):
    """The kick k_s y in x and k_s x in y."""

    id = "skew-coupling"
    stage = "optics"
    target = "quadrupole"
    parameters = (
        Parameter(
            name="skew",
            unit="1/m",
            low=-0.05,
            high=0.05,
            nominal=0.0,
            typical=0.003,
            description="Integrated skew gradient k_s. A quadrupole rolled by φ has 2 φ k1L.",
        ),
    )
    title = "coupling of the planes at a quadrupole"
    sentence = (
        "The quadrupole is rolled, or the orbit is off centre in a sextupole next to it. "
        "Horizontal correctors move the vertical orbit everywhere, and vertical ones the "
        "horizontal orbit."
    )
    equation = (
        "Δx = G_bq k_s (y_q + k_s G_qq,y x_q) / D, Δy the same with x and y exchanged, D = 1 − "
        "k_s² G_qq,x G_qq,y; exact for one thin skew quadrupole"
    )
    linear = "skew"
    confused_with = ("bpm-roll", "corrector-roll")
    splits = (
        "Excite one plane at a time. The roll of a BPM shows at that BPM only, the roll of a "
        "corrector with that corrector only."
    )
    collective = False
    standing = True

    def unavailable(self, record: Record) -> str:
        """It needs the optics, and both planes."""
        return needs_ring(record, PLANES)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Solve the coupled closed orbit with all places together."""
        return _Coupled(layout, places, values["skew"])

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole."""
        return layout.known_ring.names("QUAD")

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, both planes."""
        return two_planes(layout, "QUAD")

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Kicks by the correctors' orbit in the other plane."""
        layout, skew = record.layout, values["skew"]
        x, y = (currents @ layout.orbit_at("QUAD", plane).T for plane in PLANES)
        own_x, own_y = (
            np.diag(green(layout.known_ring, "QUAD", "QUAD", plane)) for plane in PLANES
        )
        factor = skew / (1.0 - skew**2 * own_x * own_y)
        return np.stack([factor * (y + skew * own_y * x), factor * (x + skew * own_x * y)])


class _Coupled(Effect):
    def __init__(self, layout: Layout, quadrupoles: Indices, skew: float) -> None:
        ring = layout.known_ring
        places = ring.places("QUAD")[quadrupoles]
        count = len(places)
        loop = np.eye(2 * count)
        loop[:count, count:] = -skew * green(ring, places, places, "x")
        loop[count:, :count] = -skew * green(ring, places, places, "y")
        reach = np.vstack([layout.orbit_at(places, plane) for plane in PLANES])
        x, y = np.split(np.linalg.solve(loop, reach), 2)
        back = [layout.orbit_per_kick(places, plane) for plane in PLANES]
        self._change = skew * (back[0] @ y + back[1] @ x)

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        return orbit + self._change @ currents

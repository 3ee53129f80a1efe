"""A sextupole that the linear model does not have, or has too strong."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import interpolation, two_planes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.laws import Signals
from orbitfb.effects.optics.gradients import PLANES
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_ITERATIONS = 8
_MOST_FAMILIES = 20
"""Different strengths in the table up to which magnets of one strength are taken for a family."""
_APERTURE = 0.03
"""Largest orbit that is looked at; the beam would hit the wall [m]."""


class Sextupole(SourceKind):
    """The kick −Δb2L (x² − y²) in x and +2 Δb2L x y in y."""

    id = "sextupole"
    stage = "optics"
    target = "sextupole"
    parameters = (
        Parameter(
            name="strength",
            unit="1/m²",
            low=-300.0,
            high=300.0,
            nominal=0.0,
            typical=5.0,
            description=(
                "Integrated strength b2L in addition to that of the model; a linear model has "
                "none. For several sextupoles it is the mean size: ratios and signs are those of "
                "the table of places."
            ),
        ),
    )
    title = "sextupole that the model does not have"
    sentence = (
        "The response depends on the orbit in this sextupole. Its strength differs from the model, "
        "or the model is linear and the orbit is large there."
    )
    equation = (
        "Δx = −G_bs b2L (x_s² − y_s²), Δy = +2 G_bs b2L x_s y_s; x_s and y_s come from the "
        "correctors, and between BPMs by interpolation from all else (this includes the feed-down "
        "2 b2L x_s)"
    )
    linear = "strength"
    confused_with = ("quadrupole-gradient", "bpm-nonlinearity")
    splits = (
        "Two amplitudes of the same excitation, or two reference orbits. A sextupole also doubles "
        "the frequency of tones."
    )
    collective = False
    standing = True

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Find the closed orbit through the sextupoles, tick by tick."""
        strengths = values["strength"] * self.shares(layout, places)
        return _ThroughSextupoles(layout, places, strengths)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every sextupole."""
        return layout.known_ring.names("SEXT")

    def families(self, layout: Layout) -> dict[str, Indices]:
        """All of them, which a linear model lacks, and those of one strength in the table."""
        names, strengths = self.places_of(layout), layout.known_ring.strength("SEXT")
        _, firsts, family = np.unique(strengths, return_index=True, return_inverse=True)
        found = {f"family of {names[one]}": family == index for index, one in enumerate(firsts)}
        whole = {"all": np.ones(len(names), dtype=np.bool_)}
        kept = found if len(found) <= _MOST_FAMILIES else {}
        return {name: np.flatnonzero(own) for name, own in {**whole, **kept}.items()}

    def shares(self, layout: Layout, places: Indices) -> Vector:
        """Strengths in the table, in units of the mean size; 1 of one alone."""
        strengths = layout.known_ring.strength("SEXT")[places]
        mean = float(np.mean(np.abs(strengths))) if len(places) > 1 else 0.0
        return strengths / mean if mean else np.ones(len(places))

    def refinement(self, signals: Signals) -> Matrix | None:
        """The kicks of all sextupoles at the strengths of the table."""
        layout = signals.record.layout
        if layout.ring is None:
            return None
        strengths = np.nan_to_num(layout.ring.strength("SEXT"))
        mean = float(np.mean(np.abs(strengths)))
        if not mean:
            return None
        kicks = self.drivers({"strength": mean}, signals.record, signals.currents, signals.orbit)
        planes = np.array(layout.bpms.planes)
        shares = self.shares(layout, np.arange(len(strengths)))
        orbit = [(kick * shares) @ self.patterns(layout).T for kick in kicks]
        return np.where(planes == "x", orbit[0], orbit[1])

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, both planes."""
        return two_planes(layout, "SEXT")

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Kicks to second order in the orbit.

        Correctors as a rule hold what makes up for misalignments that nobody knows: then only
        their changes tell more of the orbit between the BPMs than these do.
        """
        every = np.arange(len(record.layout.known_ring.places("SEXT")))
        return self.drivers_at(every, values, record, currents, orbit)

    def drivers_at(
        self, places: Indices, values: Values, record: Record, currents: Matrix, orbit: Matrix
    ) -> Courses:
        """The same of some sextupoles."""
        layout = record.layout
        held = orbit[0] - currents[0] @ layout.response.T
        moved = currents - currents[:1] if held @ held > orbit[0] @ orbit[0] else currents
        besides = orbit - moved @ layout.response.T
        x, y = (
            moved @ layout.orbit_at("SEXT", plane)[places].T
            + besides @ interpolation(layout, "SEXT", plane)[places].T
            for plane in PLANES
        )
        return np.stack(_kicks(np.array([values["strength"]]), x, y))


def _kicks(strength: Vector, x: Matrix, y: Matrix) -> tuple[Matrix, Matrix]:
    return -strength * (x**2 - y**2), 2.0 * strength * x * y


class _ThroughSextupoles(Effect):
    """The orbit in sextupoles is that of the correctors, exactly, and what the BPMs see besides.

    It acts among the disturbances because these move the orbit in the sextupoles too; the
    currents are remembered from `actuate`, so effects on correctors must come before it.
    """

    def __init__(self, layout: Layout, sextupoles: Indices, strength: Vector) -> None:
        ring = layout.known_ring
        places = ring.places("SEXT")[sextupoles]
        self._response, self._strength = layout.response, strength
        self._reach = [layout.orbit_at(places, plane) for plane in PLANES]
        self._between = [interpolation(layout, "SEXT", plane)[sextupoles] for plane in PLANES]
        self._own = [green(ring, places, places, plane) for plane in PLANES]
        self._back = [layout.orbit_per_kick(places, plane) for plane in PLANES]
        self._planes = [plane in layout.planes for plane in PLANES]
        self._currents = np.zeros(len(layout.correctors))

    def actuate(self, setpoints: Vector, tick: int) -> Vector:
        """Remember the currents."""
        self._currents = setpoints
        return setpoints

    def disturb(self, orbit: Vector, tick: int) -> Vector:
        """Add the orbit of the sextupoles' kicks."""
        besides = orbit - self._response @ self._currents
        start = [
            reach @ self._currents + between @ besides
            for reach, between in zip(self._reach, self._between, strict=True)
        ]
        here, kicks = start, _kicks(self._strength, start[0], start[1])
        for _ in range(_ITERATIONS):
            here = [
                np.clip(z + own @ kick, -_APERTURE, _APERTURE) if there else z
                for z, own, kick, there in zip(start, self._own, kicks, self._planes, strict=True)
            ]
            kicks = _kicks(self._strength, here[0], here[1])
        return orbit + self._back[0] @ kicks[0] + self._back[1] @ kicks[1]

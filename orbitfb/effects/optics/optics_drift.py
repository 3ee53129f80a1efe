"""Optics that drift: gradients of quadrupoles that change steadily."""

import numpy as np

from orbitfb.effects.kicks import two_planes
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.optics.gradients import ChangedGradients, gradient_kicks
from orbitfb.effects.orbit_kinds import Courses, SourceKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class OpticsDrift(SourceKind):
    """R(t) = R₀ + t ΔR, ΔR of quadrupoles that change at rates of their own."""

    id = "optics-drift"
    stage = "optics"
    target = "quadrupole"
    parameters = (
        Parameter(
            name="rate",
            unit="1/s",
            low=-1e-2,
            high=1e-2,
            nominal=0.0,
            typical=1e-4,
            description=(
                "Relative change Δk/k of the gradient per second. For several quadrupoles it is "
                "the rms, and each has a rate of its own."
            ),
        ),
    )
    title = "drift of the optics"
    sentence = (
        "The response slowly moves away from the model, because the gradients of quadrupoles "
        "change (temperature, power supplies, an insertion device that moves). Measure the "
        "response again."
    )
    equation = (
        "R(t) = R₀ + ΔR(Δk(t)), Δk_q(t) = r_q k_q t, r_q normal; ΔR as for quadrupole-gradient"
    )
    linear = "rate"
    confused_with = ("quadrupole-gradient", "tune-drift", "tune-shift")
    splits = "The same dither at the beginning and at the end of an hour, or the measured tunes."
    collective = True
    sudden = False
    grows = True

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Let gradients grow: one at the rate, several at random rates of that rms."""
        strength = np.nan_to_num(layout.known_ring.strength("QUAD"))[places]
        rates = rng.standard_normal(len(places)) if len(places) > 1 else np.ones(len(places))
        return ChangedGradients(layout, places, values["rate"] * rates * strength, growing=True)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every quadrupole."""
        return layout.known_ring.names("QUAD")

    def patterns(self, layout: Layout) -> Matrix:
        """Orbit per kick, both planes."""
        return two_planes(layout, "QUAD")

    def drivers(self, values: Values, record: Record, currents: Matrix, orbit: Matrix) -> Courses:
        """Kicks by the orbit in gradients that grow."""
        every = np.arange(len(record.layout.known_ring.places("QUAD")))
        return self.drivers_at(every, values, record, currents, orbit)

    def drivers_at(
        self, places: Indices, values: Values, record: Record, currents: Matrix, orbit: Matrix
    ) -> Courses:
        """The same of some quadrupoles."""
        strength = np.nan_to_num(record.layout.known_ring.strength("QUAD"))[places]
        gradients = np.outer(values["rate"] * record.time, strength)
        return gradient_kicks(record.layout, places, gradients, currents, orbit)

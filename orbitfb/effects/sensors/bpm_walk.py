"""A BPM whose offset wanders."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.noise.noise_correlated import groups_in_common
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout


class BpmWalk(NoiseKind):
    """y = x + o with o a random walk, of one BPM or in common of a group."""

    id = "bpm-walk"
    stage = "sensor"
    target = "bpm"
    colour = "walk"
    collective = False
    sudden = False
    parameters = (
        Parameter(
            "step", "m", 0.0, 1e-4, 0.0, 2e-8, "Rms change of the offset from tick to tick.", True
        ),
    )
    title = "wandering offset of a BPM"
    sentence = (
        "The reading of one BPM, or of all BPMs that share a crate, wanders although the beam does "
        "not. The usual reason is the temperature of the electronics. The feedback moves the beam "
        "along with the reading."
    )
    equation = "y_n = x_n + o_n, o_n = o_{n−1} + w, one w for all BPMs of the group and plane"
    also_called = ("bpm-drift",)
    confused_with = ("bpm-drift", "thermal-drift", "bpm-offset", "noise-correlated")
    splits = (
        "All BPMs see a motion of the beam, in the shape of a kick. Record the temperature of the "
        "crate with the orbit."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add one number per plane that walks to all the columns."""
        vertical = np.array([layout.bpms.planes[int(i)] == "y" for i in places], dtype=np.intp)
        return _Walk(places, vertical, values["step"], rng)

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Every BPM, then every group that may have it in common, plane by plane."""
        single = tuple(layout.bpms.label(column) for column in range(len(layout.bpms)))
        return (*single, *(label for label, _ in groups_in_common(layout)))

    def patterns(self, layout: Layout) -> Matrix:
        """One in the BPM, or in those of the group."""
        groups = groups_in_common(layout)
        shapes = np.hstack([np.eye(len(layout.bpms)), np.zeros((len(layout.bpms), len(groups)))])
        for place, (_, columns) in enumerate(groups):
            shapes[columns, len(layout.bpms) + place] = 1.0
        return shapes

    def variance(self, values: Values, reading_noise: float) -> float:
        """Square of the step, per tick."""
        return values["step"] ** 2

    def size(self, variance: float, reading_noise: float) -> float:
        """Rms of the step; zero where there is less than nothing."""
        return math.sqrt(max(variance, 0.0))


class _Walk(Effect):
    def __init__(
        self, places: Indices, plane: Indices, step: float, rng: np.random.Generator
    ) -> None:
        self._places, self._plane, self._step, self._rng = places, plane, step, rng
        self._offset = np.zeros(2)

    def sense(self, orbit: Vector, tick: int) -> Vector:
        self._offset = self._offset + self._step * self._rng.standard_normal(2)
        readings = orbit.copy()
        readings[self._places] += self._offset[self._plane]
        return readings

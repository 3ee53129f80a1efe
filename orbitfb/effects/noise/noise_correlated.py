"""Noise that the BPMs of a crate have in common."""

import math

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.random_kinds import NoiseKind
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class NoiseCorrelated(NoiseKind):
    """v = ε + z, with one number z per tick for all BPMs of a group."""

    id = "noise-correlated"
    target = "bpm"
    parameters = (
        Parameter("rms", "m", 0.0, 1e-3, 0.0, 0.3e-6, "Rms of the common noise.", log=True),
    )
    title = "noise common to a group of BPMs"
    sentence = (
        "BPMs that share a crate, a clock or a reference have a common noise, in addition to the "
        "noise of each. The beam does not move like this."
    )
    equation = "v_i = ε_i + z for all BPMs i of the group and plane, z white with the given rms"
    collective = False
    confused_with = ("noise-level", "energy-drift", "ground-motion-level", "clock-jitter")
    splits = (
        "The shape: motion of the beam looks like the dispersion or like a kick, not like a crate."
    )

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Add one random number per plane to all the columns."""
        vertical = np.array([layout.bpms.planes[int(i)] == "y" for i in places], dtype=np.intp)
        return _Common(places, vertical, values["rms"], rng)

    def unavailable(self, record: Record) -> str:
        """Need a group."""
        inherited = super().unavailable(record)
        return inherited or ("" if self.places_of(record.layout) else "needs groups of BPMs")

    def places_of(self, layout: Layout) -> tuple[str, ...]:
        """Cells and the whole ring, plane by plane; runs of neighbours where no cell is known."""
        return tuple(label for label, _ in groups_in_common(layout))

    def patterns(self, layout: Layout) -> Matrix:
        """One in the BPMs of the group."""
        groups = groups_in_common(layout)
        shapes = np.zeros((len(layout.bpms), len(groups)))
        for place, (_, columns) in enumerate(groups):
            shapes[columns, place] = 1.0
        return shapes

    def variance(self, values: Values, reading_noise: float) -> float:
        """Square of the rms."""
        return values["rms"] ** 2

    def size(self, variance: float, reading_noise: float) -> float:
        """√κ; zero when there is less in common than nothing."""
        return math.sqrt(max(variance, 0.0))


def groups_in_common(layout: Layout) -> list[tuple[str, Indices]]:
    """Cells, or runs of neighbours where no cell is known, and all of a plane: name and columns."""
    bpms = layout.bpms
    found: list[tuple[str, Indices]] = []
    for plane in layout.planes:
        own = bpms.in_plane(plane)
        runs = [
            (f"{cell} ({plane})", np.intersect1d(columns, own))
            for cell, columns in bpms.groups().items()
        ] or _runs(layout, own)
        found += [run for run in runs if 1 < len(run[1]) < len(own)]
        if len(own) > 1:
            found.append((f"all ({plane})", own))
    return found


def _runs(layout: Layout, columns: Indices) -> list[tuple[str, Indices]]:
    """Runs of 2, 3, 4, 6, 8, 12, … neighbours that begin at any BPM."""
    found: list[tuple[str, Indices]] = []
    for length in (size for two in (2, 4, 8, 16, 32, 64) for size in (two, two + two // 2)):
        for begin in range(0, len(columns) - length + 1):
            run = columns[begin : begin + length]
            ends = layout.bpms.names[int(run[0])], layout.bpms.label(int(run[-1]))
            found.append((f"{ends[0]} to {ends[1]}", run))
    return found


class _Common(Effect):
    def __init__(
        self, places: Indices, plane: Indices, rms: float, rng: np.random.Generator
    ) -> None:
        self._places, self._plane, self._rms, self._rng = places, plane, rms, rng

    def sense(self, orbit: Vector, tick: int) -> Vector:
        readings = orbit.copy()
        readings[self._places] += self._rms * self._rng.standard_normal(2)[self._plane]
        return readings

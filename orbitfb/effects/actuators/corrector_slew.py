"""A power supply that cannot change its current faster than a certain rate."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import (
    Arithmetic,
    ColumnsEffect,
    followed,
    lacks_motion,
    ladder,
    largest_change,
)
from orbitfb.effects.device_kinds import SteppingKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorSlew(SteppingKind):
    """Currents that ramp towards their setpoints at a limited rate."""

    id = "corrector-slew"
    stage = "actuator"
    title = "slew-rate limit of a corrector"
    sentence = (
        "The current follows small steps at once, but large steps only at a limited rate. Raise "
        "the ramp rate of the power supply, or lower the largest step of the feedback."
    )
    equation = "θ_n = θ_{n−1} + clip(u_n − θ_{n−1}, ± r T)"
    parameters = (
        Parameter(
            name="rate",
            unit="A/s",
            low=1e-6,
            high=1e6,
            nominal=1e6,
            typical=5e-3,
            description="Largest rate of change r of the current, of either sign.",
            log=True,
        ),
    )
    confused_with = ("corrector-lag", "corrector-gain", "corrector-deadband", "corrector-stuck")
    splits = "Steps of three sizes. A slew rate delays only the large ones, a lag delays all."

    def drive_each(
        self, setpoints: Matrix, values: Mapping[str, float | Vector], record: Record
    ) -> Matrix:
        """Ramp, row by row."""
        most = values["rate"] * record.layout.period

        def law(own: Arithmetic, wanted: Any, held: Any) -> Any:
            return own.least(own.most(wanted, held - most), held + most)

        return followed(setpoints, record, law, np.ndim(most) > 0)

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """A current that goes nowhere is stuck."""
        return lacks_motion(setpoints, self.drive(setpoints, values, record))

    def grid(self, record: Record) -> tuple[Values, ...]:
        """24 rates up to that of the largest step of the record."""
        fastest = largest_change(record) / record.layout.period
        return ladder("rate", {}, fastest * np.geomspace(1e-3, 0.95, 16))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Ramp tick by tick."""
        return _Slew(places, values["rate"] * layout.period)


class _Slew(ColumnsEffect):
    def __init__(self, places: Indices, most: float) -> None:
        super().__init__(places)
        self._most = most
        self._current: Vector | None = None

    def follow(self, wanted: Vector) -> Vector:
        before = wanted if self._current is None else self._current
        self._current = np.clip(wanted, before - self._most, before + self._most)
        return self._current

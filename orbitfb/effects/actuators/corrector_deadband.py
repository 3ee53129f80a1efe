"""A corrector that ignores small changes of its setpoint."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import (
    Arithmetic,
    ColumnsEffect,
    followed,
    ladder,
    largest_change,
    widths,
)
from orbitfb.effects.device_kinds import SteppingKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record


class CorrectorDeadband(SteppingKind):
    """Currents that stay until the setpoint is far enough away, and then go there at once.

    Where the current was within the band before the record began is not known: it is taken to
    be at its setpoint.
    """

    id = "corrector-deadband"
    stage = "actuator"
    title = "dead-band of a corrector"
    sentence = (
        "The corrector ignores a setpoint that differs from its current by less than a threshold. "
        "When the difference is larger, it catches up in one jump. Small corrections are lost "
        "until then. Make the dead-band of the device or of the control system narrower."
    )
    equation = "θ_n = u_n if |u_n − θ_{n−1}| > w, else θ_{n−1}"
    parameters = (
        Parameter(
            name="width",
            unit="A",
            low=0.0,
            high=10.0,
            nominal=0.0,
            typical=1e-3,
            description="Largest difference w that is ignored, of either sign.",
            log=True,
        ),
    )
    confused_with = (
        "corrector-hysteresis",
        "corrector-quantisation",
        "corrector-stuck",
        "missed-write",
    )
    splits = "Series of small steps up and down. A dead-band lets them through in one jump."

    def drive_each(
        self, setpoints: Matrix, values: Mapping[str, float | Vector], record: Record
    ) -> Matrix:
        """Hold or follow, row by row."""
        width = values["width"]

        def law(own: Arithmetic, wanted: Any, held: Any) -> Any:
            return own.either(abs(wanted - held) > width, wanted, held)

        return followed(setpoints, record, law, np.ndim(width) > 0)

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """A current that never catches up is stuck, one that does so once has jumped."""
        jumps = np.count_nonzero(np.diff(self.drive(setpoints, values, record), axis=0), axis=0)
        return "the current catches up less than twice" if jumps.max(initial=0) < 2 else ""

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Widths up to several times the largest change: it is dead to them or not."""
        return ladder("width", {}, widths(record, 6.0 * largest_change(record)))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold or follow tick by tick."""
        return _Deadband(places, values["width"])


class _Deadband(ColumnsEffect):
    def __init__(self, places: Indices, width: float) -> None:
        super().__init__(places)
        self._width = width
        self._current: Vector | None = None

    def follow(self, wanted: Vector) -> Vector:
        before = wanted if self._current is None else self._current
        far = np.abs(wanted - before) > self._width
        self._current = np.where(far, wanted, before)
        return self._current

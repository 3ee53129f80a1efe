"""A corrector whose current has a limit that its setpoint knows nothing of."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import ColumnsEffect, ladder, largest_setpoint, widest_range
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.layout import Layout
from orbitfb.effects.record import Record
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices

_NONE = 1e3  # [A]; no corrector reaches it
_HINTED = 3
"""Correctors whose own ranges are looked at."""
_SHARES = np.array([0.1, 0.2, 0.3, 0.4, 0.55, 0.75])


class CorrectorSaturation(ActuatorKind):
    """Currents clipped at a limit."""

    id = "corrector-saturation"
    stage = "actuator"
    title = "saturation of a corrector"
    sentence = (
        "The current stops at a limit below the one that the feedback knows, and what is asked "
        "beyond is lost until the setpoint comes back. Give the feedback the true limit, or "
        "unload the corrector by moving magnets or the reference orbit."
    )
    equation = "θ_n = clip(u_n, ± m)"
    parameters = (
        Parameter(
            name="limit",
            unit="A",
            low=0.0,
            high=_NONE,
            nominal=_NONE,
            typical=0.05,
            description="Largest current m, either sign.",
            log=True,
        ),
    )
    confused_with = ("corrector-stuck", "corrector-gain")
    splits = "A slow ramp of this corrector through the suspected limit, at both signs."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Clip."""
        return np.clip(setpoints, -values["limit"], values["limit"])

    def grid(self, record: Record) -> tuple[Values, ...]:
        """At most 30 limits: dense near the largest setpoint, and over all sizes that are reached.

        A corrector that is far from zero and moves little is clipped only by limits that lie
        within its range, so the sizes of the setpoints themselves are taken as well.
        """
        reach = largest_setpoint(record)
        near = reach - widest_range(record) * np.linspace(0.05, 1.0, 5)
        sizes = np.quantile(np.abs(record.setpoints), np.linspace(0.1, 0.999, 7))
        limits = np.concatenate([near, sizes, reach * np.geomspace(0.05, 0.98, 6)])
        return ladder("limit", {}, np.unique(limits[(limits > 0) & (limits < reach)]))

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> tuple[Values, ...]:
        """Limits within the ranges of the correctors that are pulled most to a smaller current."""
        size = np.abs(setpoints)
        top, reach = size.max(axis=0), np.ptp(size, axis=0)
        limits = top - reach * _SHARES[:, None]
        cuts = np.sign(setpoints) * np.minimum(limits[:, None, :] - size, 0.0)
        pulled = np.einsum("km,skm->sm", pull, cuts).max(axis=0)
        columns = np.argsort(pulled)[::-1][:_HINTED]
        return ladder("limit", {}, np.sort(limits[:, columns][limits[:, columns] > 0.0]))

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Clip tick by tick."""
        return _Saturation(places, values["limit"])


class _Saturation(ColumnsEffect):
    def __init__(self, places: Indices, limit: float) -> None:
        super().__init__(places)
        self._limit = limit

    def follow(self, wanted: Vector) -> Vector:
        return np.where(np.abs(wanted) > self._limit, np.sign(wanted) * self._limit, wanted)

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
    equation = "θ_n = clip(u_n, ± m), or on one side alone"
    parameters = (
        Parameter(
            name="limit",
            unit="A",
            low=0.0,
            high=_NONE,
            nominal=_NONE,
            typical=0.05,
            description="The limit m, without its sign.",
            log=True,
        ),
        Parameter(
            name="side",
            unit="1",
            low=-2.0,
            high=2.0,
            nominal=0.0,
            typical=0.0,
            description="Which limit there is.",
            whole=True,
            meanings={1: "θ ≤ m", 2: "θ ≤ −m", -1: "θ ≥ −m", -2: "θ ≥ m", 0: "both, ± m"},
        ),
    )
    confused_with = ("corrector-stuck", "corrector-gain")
    splits = "A slow ramp of this corrector through the suspected limit, at both signs."

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Clip."""
        limit, side = values["limit"], round(values["side"])
        least = {0: -limit, -1: -limit, -2: limit}.get(side, -np.inf)
        most = {0: limit, 1: limit, 2: -limit}.get(side, np.inf)
        return np.clip(setpoints, least, most)

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Fit the limit; on which side it is, is found by the scan."""
        return self.parameters[:1]

    def grid(self, record: Record) -> tuple[Values, ...]:
        """At most 30 limits: dense near the largest setpoint, and over all sizes that are reached.

        A corrector that is far from zero and moves little is clipped only by limits that lie
        within its range, so the sizes of the setpoints themselves are taken as well.
        """
        reach = largest_setpoint(record)
        near = reach - widest_range(record) * np.linspace(0.05, 1.0, 5)
        sizes = np.quantile(np.abs(record.setpoints), np.linspace(0.1, 0.999, 7))
        limits = np.concatenate([near, sizes, reach * np.geomspace(0.05, 0.98, 6)])
        return ladder("limit", {"side": 0.0}, np.unique(limits[(limits > 0) & (limits < reach)]))

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> tuple[Values, ...]:
        """Limits within the ranges of the correctors that are pulled most to what they leave."""
        sign = np.sign(setpoints)
        sets = [{"limit": m, "side": 0.0} for m in _pulled(np.abs(setpoints), sign * pull) if m > 0]
        for upper in (1.0, -1.0):
            sets += [
                {"limit": abs(m), "side": upper * (1.0 if m >= 0.0 else 2.0)}
                for m in _pulled(upper * setpoints, upper * pull)
            ]
        return tuple(sets)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Clip tick by tick."""
        return _Saturation(places, values["limit"], int(values["side"]))


def _pulled(courses: Matrix, pull: Matrix) -> list[float]:
    """Limits from above of the courses that are pulled most to what they leave [A]."""
    top, reach = courses.max(axis=0), np.ptp(courses, axis=0)
    limits = top - reach * _SHARES[:, None]
    cuts = np.minimum(limits[:, None, :] - courses, 0.0)
    pulled = np.einsum("km,skm->sm", pull, cuts).max(axis=0)
    columns = np.argsort(pulled)[::-1][:_HINTED]
    return np.sort(limits[:, columns], axis=None).tolist()


class _Saturation(ColumnsEffect):
    def __init__(self, places: Indices, limit: float, side: int) -> None:
        super().__init__(places)
        self._limit, self._side = limit, side

    def follow(self, wanted: Vector) -> Vector:
        if self._side == 0:
            return np.where(np.abs(wanted) > self._limit, np.sign(wanted) * self._limit, wanted)
        edge = self._limit if self._side in (1, -2) else -self._limit
        return np.minimum(wanted, edge) if self._side > 0 else np.maximum(wanted, edge)

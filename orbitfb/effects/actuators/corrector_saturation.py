"""A corrector whose current has a limit that its setpoint knows nothing of."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.actuating import (
    ColumnsEffect,
    lacks_motion,
    ladder,
    largest_setpoint,
    widest_range,
)
from orbitfb.effects.device_kinds import ActuatorKind
from orbitfb.effects.kinds import OwnValues, Parameter, Values
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_NONE = 1e3  # [A]; no corrector reaches it
_SHARP = 1e-6  # [A]; no corner is sharper
_CORNER = 40.0
"""Roundings from the limit beyond which a corner is straight to the last digit."""
_HINTED = 3
"""Correctors whose own ranges are looked at."""
_TRIED = 4
"""Corners of each that are, those that stand out most from what a change so large makes alone."""
_CORNERS = (
    (0.0, (0.1, 0.2, 0.3, 0.4, 0.55, 0.75)),
    (0.05, (0.0, 0.05, 0.1, 0.2, 0.4)),
    (0.15, (-0.3, -0.1, 0.1, 0.3)),
    (0.5, (-0.6, 0.0, 0.6)),
)
"""Roundings, and with each distances of the limit below the top, as shares of the range."""

_SOFT = ((0.15, (-0.3, 0.0, 0.3)), (0.5, (-0.6, 0.0, 0.6)))
"""Roundings of soft limits, and their distances below the top, as shares of the range: over a wider
corner a setpoint moves in a straight line."""

_SHARES = (0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98)
"""Shares of the rows in which a setpoint is below the limits that are scanned."""

_BEYOND = (0.5, 1.0, 3.0, 10.0)
"""Rows in which it is above further limits, as few rows may show one; between the two largest
setpoints half a row lies. A change of twice its true size is as likely as none."""


class CorrectorSaturation(ActuatorKind):
    """Currents that a limit holds back: clipped, or bent over a rounded corner.

    What is above an upper limit m is lost, θ = u − w log(1 + exp((u − m)/w)) with the rounding w:
    clip(u, m) where w is small, iron that saturates where it is not.
    """

    id = "corrector-saturation"
    stage = "actuator"
    title = "saturation of a corrector"
    sentence = (
        "The current stops at a limit below the one that the feedback knows. Larger setpoints have "
        "no effect. Give the feedback the true limit, or unload the corrector: move magnets or the "
        "reference orbit."
    )
    equation = (
        "θ_n = u_n − s(u_n − m) + s(−m − u_n) with the smooth excess s(d) = w log(1 + exp(d/w)), "
        "or one of the two terms; for w = 0: clip(u_n, ± m)"
    )
    parameters = (
        Parameter(
            name="limit",
            unit="A",
            low=0.0,
            high=_NONE,
            nominal=_NONE,
            typical=0.05,
            description="Limit m, without its sign.",
            log=True,
        ),
        Parameter(
            name="side",
            unit="1",
            low=-2.0,
            high=2.0,
            nominal=0.0,
            typical=0.0,
            description="Which limits there are.",
            whole=True,
            meanings={1: "θ ≤ m", 2: "θ ≤ −m", -1: "θ ≥ −m", -2: "θ ≥ m", 0: "both, ± m"},
        ),
        Parameter(
            name="rounding",
            unit="A",
            low=_SHARP,
            high=10.0,
            nominal=_SHARP,
            typical=_SHARP,
            description="Width w of the rounded corner. At the limit itself 0.69 w is missing.",
            log=True,
            optional=True,
        ),
    )
    confused_with = ("corrector-stuck", "corrector-gain")
    splits = "A slow ramp of this corrector through the suspected limit, with both signs."

    def own_grid(self, record: Record) -> tuple[OwnValues, ...]:
        """Limits at shares of the sizes that every corrector's setpoint has; soft ones about it."""
        every = np.abs(record.setpoints)
        shares = np.append(_SHARES, 1.0 - np.array(_BEYOND) / (len(every) - 1))
        sizes = np.quantile(every, np.clip(shares, 0.0, 1.0), axis=0)
        sharp = [{"limit": one, "side": 0.0, "rounding": _SHARP} for one in sizes]
        top, reach = every.max(axis=0), np.maximum(np.ptp(every, axis=0), _SHARP)
        soft = [
            {"limit": top - share * reach, "side": 0.0, "rounding": rounding * reach}
            for rounding, below in _SOFT
            for share in below
        ]
        return (*sharp, *soft)

    def drive(self, setpoints: Matrix, values: Values, record: Record) -> Matrix:
        """Hold back."""
        return _held(setpoints, values)

    def lacks(self, setpoints: Matrix, values: Values, record: Record) -> str:
        """Between limits with no room it is stuck, or tripped."""
        return lacks_motion(setpoints, self.drive(setpoints, values, record))

    def fitted(self, record: Record) -> tuple[Parameter, ...]:
        """Fit limit and rounding; on which side it is, is found by the scan."""
        limit, _, rounding = self.parameters
        return limit, rounding

    def grid(self, record: Record) -> tuple[Values, ...]:
        """At most 30 limits: dense near the largest setpoint, and over all sizes that are reached.

        A corrector that is far from zero and moves little is clipped only by limits that lie
        within its range, so the sizes of the setpoints themselves are taken as well.
        """
        reach = largest_setpoint(record)
        near = reach - widest_range(record) * np.linspace(0.05, 1.0, 5)
        sizes = np.quantile(np.abs(record.setpoints), np.linspace(0.1, 0.999, 7))
        limits = np.concatenate([near, sizes, reach * np.geomspace(0.05, 0.98, 6)])
        others = {"side": 0.0, "rounding": _SHARP}
        return ladder("limit", others, np.unique(limits[(limits > 0) & (limits < reach)]))

    def hints(self, setpoints: Matrix, pull: Matrix, record: Record) -> tuple[Values, ...]:
        """Limits within the ranges of the correctors that are pulled most to what they leave."""
        sign = np.sign(setpoints)
        found = [
            {"limit": m, "side": 0.0, "rounding": w}
            for m, w in _pulled(np.abs(setpoints), sign * pull)
            if m > 0
        ]
        for upper in (1.0, -1.0):
            found += [
                {"limit": abs(m), "side": upper * (1.0 if m >= 0.0 else 2.0), "rounding": w}
                for m, w in _pulled(upper * setpoints, upper * pull)
            ]
        return tuple(found)

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Hold back tick by tick."""
        return _Saturation(places, values)


def _held(wanted: Matrix, values: Values) -> Matrix:
    """What comes of currents [A]."""
    limit, side = values["limit"], round(values["side"])
    rounding = values.get("rounding", _SHARP)
    edges = {0: (-limit, limit), 1: (None, limit), 2: (None, -limit)}
    least, most = {**edges, -1: (-limit, None), -2: (limit, None)}[side]
    beyond = np.zeros_like(wanted)
    if most is not None:
        beyond += _beyond(wanted - most, rounding)
    if least is not None:
        beyond -= _beyond(least - wanted, rounding)
    return wanted - beyond


def _beyond(distance: Matrix, rounding: float | Vector) -> Matrix:
    """What is lost at a distance above a limit with a rounded corner; both [A]."""
    lost = np.maximum(distance, 0.0)
    near = np.abs(distance) < _CORNER * rounding
    if near.any():
        width = np.broadcast_to(rounding, distance.shape)[near]
        lost[near] = width * np.logaddexp(0.0, distance[near] / width)
    return lost


def _pulled(courses: Matrix, pull: Matrix) -> list[tuple[float, float]]:
    """Limits from above of the courses that are pulled most to what they leave, with roundings.

    Args:
        courses: Of all correctors, shape (rows, m) [A].
        pull: Derivative of the log-likelihood by their currents, the same shape.
    """
    top, reach = courses.max(axis=0), np.ptp(courses, axis=0)
    corners = [(below, rounding) for rounding, shares in _CORNERS for below in shares]
    score = np.zeros((len(corners), courses.shape[1]))
    clear = np.zeros_like(score)
    for index, (below, rounding) in enumerate(corners):
        lost = _beyond(courses - (top - reach * below), np.maximum(rounding * reach, _SHARP))
        moved = np.sqrt(np.sum(np.diff(lost, axis=0) ** 2, axis=0))
        score[index] = -np.sum(pull * lost, axis=0)
        clear[index] = np.divide(score[index], moved, out=np.zeros_like(moved), where=moved > 0.0)
    found: list[tuple[float, float]] = []
    for column in np.argsort(score.max(axis=0))[::-1][:_HINTED]:
        for index in np.argsort(clear[:, column])[::-1][:_TRIED]:
            below, rounding = corners[int(index)]
            width = max(rounding * reach[column], _SHARP)
            found.append((float(top[column] - below * reach[column]), float(width)))
    return found


class _Saturation(ColumnsEffect):
    def __init__(self, places: Indices, values: Values) -> None:
        super().__init__(places)
        self._values = values

    def follow(self, wanted: Vector) -> Vector:
        limit, side = self._values["limit"], round(self._values["side"])
        width = self._values.get("rounding", _SHARP)
        edge = limit if side in (0, 1, -2) else -limit
        lost = np.zeros_like(wanted)
        if side >= 0:
            lost += _excess(wanted - edge, width)
        if side <= 0:
            lower = -limit if side == 0 else edge
            lost -= _excess(lower - wanted, width)
        return wanted - lost


def _excess(distance: Vector, width: float) -> Vector:
    """What is beyond an edge with a rounded corner [A]."""
    return np.maximum(distance, 0.0) + width * np.log1p(np.exp(-np.abs(distance) / width))

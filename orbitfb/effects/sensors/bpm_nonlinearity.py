"""Curved characteristic of a BPM."""

import math
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.device_kinds import SensorKind
from orbitfb.effects.kinds import Parameter, Values
from orbitfb.effects.readings import ChangedReadings
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices
from orbitfb.records.layout import Layout
from orbitfb.records.record import Record

_FLATTEST = 0.2
"""Least slope: where the cubic gets flatter, the characteristic goes on straight. So it can be
undone everywhere, and no reading is worth an infinite likelihood."""
_BOTH = 0.1
"""Share of the largest reading by which both sizes bend it, where both are scanned."""
_STEPS = 12
_HALVINGS = 80


class BpmNonlinearity(SensorKind):
    """y = x + a₂ x² + a₃ x³."""

    id = "bpm-nonlinearity"
    stage = "sensor"
    parameters = (
        Parameter(
            "quadratic",
            "1/m",
            -1e5,
            1e5,
            0.0,
            200.0,
            "Coefficient a₂: the curve bends to one side.",
        ),
        Parameter(
            "cubic",
            "1/m²",
            -1e10,
            1e10,
            0.0,
            2e5,
            "Coefficient a₃. If it is negative, the reading saturates.",
        ),
    )
    title = "curved characteristic of a BPM"
    sentence = (
        "The BPM reads right near its centre. Its error grows with the distance from the centre "
        "(pincushion, saturation), so its gain depends on where the orbit is."
    )
    equation = (
        "y = x + a₂x² + a₃x³, x the noisy position; a straight line beyond the point where the "
        "slope falls to 0.2 (R. E. Shafer, AIP Conf. Proc. 212 (1990) 26)"
    )
    scales = True  # by its slope where the orbit is
    homogeneous = True
    confused_with = ("bpm-gain", "sextupole")
    splits = "A closed bump through the BPM at three levels or more, with both signs."

    def simulate(
        self, layout: Layout, places: Indices, values: Values, rng: np.random.Generator
    ) -> Effect:
        """Bend the readings."""
        return ChangedReadings(places, _Curve.of(values).bend)

    def grid(self, record: Record) -> tuple[Values, ...]:
        """Sizes that bend the largest readings of this record by some per cent and more."""
        largest = float(np.max(np.abs(record.readings), initial=0.0)) or 1e-3
        quadratic, cubic = self.parameters
        found: list[Values] = []
        for share in (-0.3, -0.1, -0.03, 0.03, 0.1, 0.3):
            a2 = min(max(share / largest, quadratic.low), quadratic.high)
            a3 = min(max(share / largest**2, cubic.low), cubic.high)
            found += [{"quadratic": a2, "cubic": 0.0}, {"quadratic": 0.0, "cubic": a3}]
            if abs(share) == _BOTH:
                found += [{"quadratic": a2, "cubic": a3}, {"quadratic": a2, "cubic": -a3}]
        return tuple(found)

    def restore(self, readings: Matrix, values: Values, record: Record) -> tuple[Matrix, Vector]:
        """Straighten the readings."""
        curve = _Curve.of(values)
        restored = curve.straighten(readings)
        return restored, -np.sum(np.log(curve.slope(restored)), axis=1)

    def distort(self, orbit: Matrix, values: Values, record: Record) -> Matrix:
        """Bend."""
        return _Curve.of(values).bend(orbit)


@dataclass(frozen=True, slots=True)
class _Curve:
    """The cubic between `low` and `high`, straight on beyond."""

    quadratic: float
    cubic: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Values) -> "_Curve":
        """Find where the slope falls to the least one, next to zero on both sides."""
        quadratic, cubic = values["quadratic"], values["cubic"]
        roots: tuple[float, ...] = ()
        inside = quadratic**2 - 3.0 * cubic * (1.0 - _FLATTEST)
        if inside > 0.0:
            # 3 a₃ x² + 2 a₂ x + (1 − s) = 0 by the form that also holds for a₃ = 0
            divisors = (-quadratic - math.sqrt(inside), -quadratic + math.sqrt(inside))
            roots = tuple((1.0 - _FLATTEST) / d for d in divisors if d != 0.0)
        return cls(
            quadratic,
            cubic,
            max((x for x in roots if x < 0.0), default=-math.inf),
            min((x for x in roots if x > 0.0), default=math.inf),
        )

    def bend(self, x: Matrix) -> Matrix:
        """Reading of a position."""
        inner = np.clip(x, self.low, self.high)
        bent = inner + inner * inner * (self.quadratic + self.cubic * inner)
        return bent + _FLATTEST * (x - inner)

    def slope(self, x: Matrix) -> Matrix:
        """Derivative of `bend`."""
        inner = np.clip(x, self.low, self.high)
        return 1.0 + inner * (2.0 * self.quadratic + 3.0 * self.cubic * inner)

    def straighten(self, y: Matrix) -> Matrix:
        """Position of a reading: Newton's method, halving for what it does not reach."""
        x = y.copy()
        tolerance = 1e-14 + 1e-12 * np.abs(y)
        for _ in range(_STEPS):
            left = self.bend(x) - y
            if np.all(np.abs(left) <= tolerance):
                return x
            x -= left / self.slope(x)
        missed = np.abs(self.bend(x) - y) > tolerance
        if missed.any():
            x[missed] = self._halve(y[missed])
        return x

    def _halve(self, y: Vector) -> Vector:
        # the slope is at least _FLATTEST everywhere and the curve goes through zero
        reach = np.abs(y) / _FLATTEST
        low, high = -reach, reach
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            above = self.bend(middle) > y
            high, low = np.where(above, middle, high), np.where(above, low, middle)
        return 0.5 * (low + high)

"""The parameters of causes as one vector, and what is left of a record at any values of it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.kinds import EffectKind, Parameter
from orbitfb.physics.optics import Matrix

_WIDE = 1.5
"""Prior width of a parameter known by order of magnitude, in its logarithm."""

Left = tuple[Matrix, Vector, Vector]
"""White innovations, sizes of the background, log-Jacobian by row."""


class Problem:
    """Fitted values as one vector: logarithms where a parameter is known by magnitude.

    Args:
        bench: The record under the causes that stay as they are.
        causes: To be fitted.

    Attributes:
        parameters: (cause, parameter) of every fitted value.
        start: Their values at the beginning, shape (k,).
        scale: Widths of their priors, shape (k,).
        low: Least values, shape (k,).
        high: Largest values, shape (k,).
        smooth: Positions of those that have derivatives.
        lines: Positions of frequencies of waves: the scan has chosen a line among all, so that
            what is open is its place within the width of a line.
    """

    def __init__(self, bench: Bench, causes: Sequence[Cause]) -> None:
        self.bench, self.causes = bench, tuple(causes)
        self.parameters = tuple(
            (index, parameter)
            for index, cause in enumerate(causes)
            for parameter in cause.kind.fitted(bench.record)
            if parameter.high > parameter.low and not left_out(parameter, cause)
        )
        self.start = np.array(
            [to_fitted(p, self.causes[i].values[p.name]) for i, p in self.parameters]
        )
        self.scale = np.array([prior_width(p) for _, p in self.parameters])
        length = max(float(np.ptp(bench.record.time)), bench.record.layout.period)
        self.lines = [
            index
            for index, (owner, p) in enumerate(self.parameters)
            if is_line(self.causes[owner].kind, p)
        ]
        self.scale[self.lines] = 1.0 / length
        self.low = np.array([to_fitted(p, p.low) for _, p in self.parameters])
        self._rate = 1.0 / bench.record.layout.period
        self.high = np.array([to_fitted(p, highest(p, self._rate)) for _, p in self.parameters])
        self.smooth = [
            index for index, (_, p) in enumerate(self.parameters) if not (p.rough or p.whole)
        ]

    def at(self, vector: Vector) -> tuple[Cause, ...]:
        """Put values into the causes."""
        values = [dict(cause.values) for cause in self.causes]
        for (index, parameter), number in zip(self.parameters, vector, strict=True):
            value = from_fitted(parameter, float(number))
            most = highest(parameter, self._rate)
            values[index][parameter.name] = float(np.clip(value, parameter.low, most))
        return tuple(
            replace(cause, values=own) for cause, own in zip(self.causes, values, strict=True)
        )

    def residual(self, vector: Vector) -> Left:
        """Judge values."""
        return self.bench.residual(self.at(vector))

    def difference(self, vector: Vector, other: Vector) -> Left:
        """What `residual` of values is more than that of others."""
        return self.bench.difference(self.at(vector), self.at(other))

    def nudge(self, vector: Vector, index: int) -> float:
        """A small change of a value, within its bounds."""
        parameter = self.parameters[index][1]
        far = abs(vector[index] - parameter.nominal)
        size = 0.02 if parameter.log else 0.01 * max(far, 0.1 * self.scale[index])
        return -size if vector[index] + size > self.high[index] else size

    def likelihood(
        self, vector: Vector, index: int, number: float, *, roughly: bool = False
    ) -> float:
        """Log-likelihood with one value changed, as `beside` does [nats]."""
        return self.beside(vector, index, number, roughly=roughly)[0]

    def beside(
        self, vector: Vector, index: int, number: float, *, roughly: bool = False
    ) -> tuple[float, Vector]:
        """Change one value; let the one in which its cause is linear, if it has one, follow.

        Args:
            vector: All values, shape (k,).
            index: Of the one to change.
            number: To this.
            roughly: Whether to leave the healthy errors as they are, which is several times as
                fast: for a choice among values that is made again.

        Returns:
            Log-likelihood [nats], and all values, shape (k,).
        """
        there = vector.copy()
        there[index] = number
        judge = self.bench.roughly if roughly else self.bench.residual
        now = judge(self.at(there))
        height, own = log_likelihood(*now), self.parameters[index][0]
        linear = [
            at
            for at, (owner, p) in enumerate(self.parameters)
            if owner == own and at != index and p.name == self.causes[own].kind.linear
        ]
        if not linear:
            return height, there
        further = there.copy()
        further[linear[0]] += 0.5 * self.scale[linear[0]]
        moved = judge(self.at(further))
        white, sizes = moved[0] - now[0], moved[1] - now[1]
        gradient = float(np.sum(white * now[0]) + np.sum(sizes * now[1]))
        curvature = float(np.sum(white**2) + np.sum(sizes**2))
        if curvature <= 0.0:
            return height, there
        best = there[linear[0]] - 0.5 * self.scale[linear[0]] * gradient / curvature
        there[linear[0]] = float(np.clip(best, self.low[linear[0]], self.high[linear[0]]))
        return height + 0.5 * gradient**2 / curvature, there


def left_out(parameter: Parameter, cause: Cause) -> bool:
    """Whether a cause has the simpler law, without an optional parameter."""
    return parameter.optional and cause.values[parameter.name] == parameter.nominal


_NEGLIGIBLE = 1e-6
"""Share of a typical size that is as good as none."""


def highest(parameter: Parameter, rate: float) -> float:
    """Largest value that a record of a rate [Hz] can tell: a higher frequency is an alias."""
    return (
        min(parameter.high, parameter.of_rate * rate) if parameter.unit == "Hz" else parameter.high
    )


def to_fitted(parameter: Parameter, value: float) -> float:
    """The number that is fitted for a value."""
    if not parameter.log:
        return value
    least = parameter.low or parameter.typical * _NEGLIGIBLE
    return float(np.log(max(value, least)))


def from_fitted(parameter: Parameter, number: float) -> float:
    """The value of a fitted number."""
    return float(np.exp(number)) if parameter.log else number


def prior_width(parameter: Parameter) -> float:
    """Width of the prior: what occurs, or a quarter of what makes sense."""
    if parameter.log:
        return _WIDE
    return abs(parameter.typical - parameter.nominal) or 0.25 * (parameter.high - parameter.low)


def is_line(kind: EffectKind, parameter: Parameter) -> bool:
    """Whether a value is the frequency of a wave, which is what it is to the last digit."""
    return parameter.name == "frequency" and getattr(kind, "periodic", False)

"""From how clearly sizes of an effect show to the smallest one that shows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.detectable_random import ENOUGH
from orbitfb.effects.kinds import EffectKind, Parameter, Values
from orbitfb.records.record import Record

_STEPS = 14
_STEPS_OF_RING = 5
"""Values tried, at most; fewer where each of them costs an exact likelihood."""


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """How clearly an effect of given values shows, at every place.

    Args:
        values: Of the effect.
        gain: Expected, shape (P,) [nats].
    """

    values: Values
    gain: Vector


def size_parameter(kind: EffectKind, record: Record) -> Parameter | None:
    """Tell which parameter is the size of an effect; None for one without parameters.

    Args:
        kind: The effect.
        record: That bears on it, perhaps in one plane only.
    """
    return next(iter(kind.fitted(record)), None)


def tried(kind: EffectKind, bench: Bench) -> list[Values]:
    """Values of the grid in which its size is not nothing, thinned, from small to large.

    One where the change is proportional to the size: it tells all of them.
    """
    grid = list(kind.grid(bench.record))
    spec = size_parameter(kind, bench.record)
    if spec is None:
        return grid[:1]
    grid = [values for values in grid if values[spec.name] != spec.nominal] or grid
    grid.sort(key=lambda values: _distance(spec, values[spec.name]))
    if spec in kind.sizes:
        return grid[:1]
    steps = _STEPS_OF_RING if kind.target == "ring" else _STEPS
    return [grid[i] for i in np.unique(np.linspace(0, len(grid) - 1, steps).astype(np.intp))]


def smallest(
    kind: EffectKind, record: Record, seen: Sequence[Seen], gains: Sequence[float]
) -> float | None:
    """Find the size at which the expected gain is enough, by the gains at the sizes tried."""
    spec = size_parameter(kind, record)
    if spec is None:
        return 1.0 if max(gains, default=0.0) > ENOUGH else None
    enough = np.flatnonzero(np.asarray(gains) > ENOUGH)
    if spec in kind.sizes:
        reach = abs(seen[0].values[spec.name] - spec.nominal)
        return _sensible(spec, reach * float(np.sqrt(ENOUGH / gains[0]))) if gains[0] > 0 else None
    if not len(enough):
        return None
    first = int(enough[0])
    size = _size(spec, seen[first].values)
    if first and gains[first - 1] > 0.0:
        before = _size(spec, seen[first - 1].values)
        share = np.log(ENOUGH / gains[first - 1]) / np.log(gains[first] / gains[first - 1])
        size = float(before * (size / before) ** share)
    return size


def _size(spec: Parameter, values: Values) -> float:
    value = values[spec.name]
    return value if spec.nominal >= spec.high else abs(value - spec.nominal)


def _distance(spec: Parameter, value: float) -> float:
    """From nothing; what is nothing at its largest value is small when it is large."""
    return -value if spec.nominal >= spec.high else abs(value - spec.nominal)


def within(kind: EffectKind, record: Record, sizes: Vector) -> tuple[float | None, float | None]:
    """Give median and smallest of the sizes of all places, where they make sense."""
    spec = size_parameter(kind, record)
    if spec is None or not len(sizes):
        return None, None
    return _sensible(spec, float(np.median(sizes))), _sensible(spec, float(np.min(sizes)))


def _sensible(spec: Parameter, size: float) -> float | None:
    """A size, if it is one that makes sense."""
    largest = max(spec.high - spec.nominal, spec.nominal - spec.low)
    return size if size <= largest else None


def median(gain: Vector) -> float:
    """Give the median over the places; 0 when there are none."""
    return float(np.median(gain)) if len(gain) else 0.0

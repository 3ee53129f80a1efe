"""One corrector by steps: move, let it settle, average orbits, go on; then fit."""

import numpy as np

from orbitfb.core.signals import Reading, Vector
from orbitfb.measure.column import Column
from orbitfb.measure.mover import Mover
from orbitfb.measure.regression import fit_column
from orbitfb.measure.sequence import levels
from orbitfb.measure.settings import MeasureSettings
from orbitfb.measure.watch import Watch

_ARRIVED = 0.02
"""Part of the amplitude by which a readback may miss its setpoint and count as arrived."""


def orbits_by_steps(settings: MeasureSettings) -> int:
    """Count the orbits of one corrector whose readback comes to its setpoint at once.

    Args:
        settings: Sizes, repeats, orbits.
    """
    steps = len(levels(settings.sizes, settings.repeats))
    return steps * (settings.settle + settings.orbits)


def measure_by_steps(
    corrector: int, amplitude: float, mover: Mover, watch: Watch, settings: MeasureSettings
) -> Column:
    """Measure one column; the corrector is left at its last step.

    Args:
        corrector: Its index.
        amplitude: Largest step, either sign [A].
        mover: Moves it.
        watch: Gives orbits.
        settings: Sizes, repeats, orbits.

    Raises:
        MeasurementError: It must be given up.
        MachineError: The machine does not do what it should.
    """
    steps = levels(settings.sizes, settings.repeats)
    orbit, readback, time = [], [], []
    for level in steps:
        mover.offset([corrector], np.array([level * amplitude]))
        wanted = mover.base[corrector] + level * amplitude
        readings = _settled(corrector, wanted, amplitude, watch, settings)
        orbit.append(_mean([watch.position(reading) for reading in readings]))
        readback.append(np.mean([reading.readback[corrector] for reading in readings]))
        time.append(np.mean([reading.orbit.time for reading in readings]))
    fit = fit_column(steps, np.array(time), np.array(orbit))
    return Column(
        fit.response / amplitude,
        fit.sigma / amplitude,
        fit.noise,
        fit.linearity,
        float(np.dot(readback, steps) / np.dot(steps, steps)) / amplitude,
        0.0,
        amplitude,
        float(time[-1]),
    )


def _settled(
    corrector: int, wanted: float, amplitude: float, watch: Watch, settings: MeasureSettings
) -> list[Reading]:
    """Wait until a step has settled, and take the orbits after it."""
    for waited in range(1, settings.settle_most + settings.settle + 1):
        missed = abs(watch.orbit().readback[corrector] - wanted)
        if waited >= settings.settle and missed <= _ARRIVED * amplitude:
            break
    return [watch.orbit() for _ in range(settings.orbits)]


def _mean(positions: list[Vector]) -> Vector:
    """Average each BPM over its valid readings; NaN where fewer than half of them are."""
    stack = np.array(positions)
    valid = np.isfinite(stack)
    count = valid.sum(axis=0)
    total = np.where(valid, stack, 0.0).sum(axis=0)
    return np.where(2 * count >= len(stack), total / np.maximum(count, 1), np.nan)

"""Supplies that are coarse, bounded or remember: the nonlinear ones."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import run
from benchmarks.blind.generator.nature_actuator import OnCurrent, usual_step
from benchmarks.blind.generator.nature_sensor import named, one_or_cell
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class Steps(OnCurrent):
    """A converter of coarse steps that are offset from zero."""

    def __init__(self, columns: Index, step: float, offset: Array) -> None:
        super().__init__(columns)
        self.step, self.offset = step, offset

    def drive(self, row: int, wanted: Array) -> Array:
        return self.step * (np.floor(wanted / self.step + self.offset) + 0.5 - self.offset)


@kind("corrector-quantisation", "actuator", onset="start")
def corrector_quantisation(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.5)
    offset = np.full(len(columns), 0.5)  # steps through zero, as a 16-bit word has them
    unit = usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Steps(columns, s * unit, offset),
        lambda s: {"step": (s * unit, "A")},
        2.0,
        300.0,
    )


class Dead(OnCurrent):
    """Follows only when the setpoint is farther than the width; then it goes all the way."""

    def __init__(self, columns: Index, width: float) -> None:
        super().__init__(columns)
        self.width = width

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy()
        self.memory = np.where(np.abs(wanted - self.memory) > self.width, wanted, self.memory)
        return self.memory


@kind("corrector-deadband", "actuator")
def corrector_deadband(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    unit = usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Dead(columns, s * unit),
        lambda s: {"width": (s * unit, "A")},
        1.0,
        300.0,
    )


class Clipped(OnCurrent):
    def __init__(self, columns: Index, low: Array, high: Array) -> None:
        super().__init__(columns)
        self.low, self.high = low, high

    def drive(self, row: int, wanted: Array) -> Array:
        return np.clip(wanted, self.low, self.high)


class SoftLimit(OnCurrent):
    """A supply that runs out of voltage softly: a corner rounded over 2 % of the limit."""

    def __init__(self, columns: Index, limit: float) -> None:
        super().__init__(columns)
        self.limit = limit

    def drive(self, row: int, wanted: Array) -> Array:
        soft, size = 0.02 * self.limit, np.abs(wanted)
        over = np.logaddexp(0.0, (size - self.limit) / soft) * soft
        return np.sign(wanted) * (size - over)


@kind("corrector-saturation", "actuator")
def corrector_saturation(case: Conditions, rng: Rng) -> Draft:
    calm = run(case, [], 1).setpoints
    # The limit lies within the reach of the setpoint of a corrector that is not near zero.
    sizes = np.abs(calm).mean(axis=0)
    busy = np.flatnonzero(sizes > np.median(sizes))
    column = int(rng.choice(busy))
    top, reach = np.abs(calm[:, column]).max(), np.ptp(calm[:, column])
    columns = np.array([column])
    return Draft(
        named(case.corr_names, columns),
        lambda s: SoftLimit(columns, max(top - s * reach, 0.02 * top)),
        lambda s: {"limit": (max(top - s * reach, 0.02 * top), "A")},
        0.5,
        10.0,
    )


class BoucWen(OnCurrent):
    """Hysteresis: z' = u' − (β sign(u' z) + γ) |z|ᵏ u', θ = u − share · z, |z| ≤ width."""

    def __init__(self, columns: Index, width: float, share: float) -> None:
        super().__init__(columns)
        self.width, self.share = width, share

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), np.zeros_like(wanted)
        before, lag = self.memory
        for _ in range(8):
            move = (wanted - before) / 8
            near = np.minimum(np.abs(lag) / self.width, 1.0) ** 2
            lag = lag + move * (1 - near * (0.7 * np.sign(move * lag) + 0.3))
        lag = np.clip(lag, -self.width, self.width)
        self.memory = wanted.copy(), lag
        return wanted - self.share * lag


@kind("corrector-hysteresis", "actuator")
def corrector_hysteresis(case: Conditions, rng: Rng) -> Draft:
    columns, unit = one_or_cell(case, case.corr_names, rng, 0.3), usual_step(case)
    return Draft(
        named(case.corr_names, columns),
        lambda s: BoucWen(columns, s * unit, 1.0),
        lambda s: {"width": (2 * s * unit, "A")},
        1.0,
        300.0,
    )

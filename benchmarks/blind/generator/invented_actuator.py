"""Actuators and sources of no library: the diagnosis is to say that it does not know them."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_actuator import OnCurrent, usual_step
from benchmarks.blind.generator.nature_disturbance import source
from benchmarks.blind.generator.nature_sensor import named, neighbours, one_or_cell, sign
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class WarmNeighbour(Nature):
    """A corrector whose gain follows the heat that its neighbour's current leaves in the rack."""

    def __init__(self, column: int, neighbour: int, size: float) -> None:
        self.column, self.neighbour, self.size = column, neighbour, size

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.heat, self.still, self.base = 0.0, None, None

    def currents(self, row: int, wanted: Array) -> Array:
        if self.still is None:
            self.still, self.base = wanted[self.neighbour], wanted[self.column]
        away = (wanted[self.neighbour] - self.still) ** 2
        self.heat += 0.03 * (away - self.heat)
        driven = wanted.copy()
        driven[self.column] = self.base + (wanted[self.column] - self.base) * (
            1 + self.size * self.heat
        )
        return driven


@kind("x-warm-neighbour", "actuator", known=False)
def warm_neighbour(case: Conditions, rng: Rng) -> Draft:
    pair, way = rng.permutation(neighbours(case, case.corr_names, rng)), sign(rng)
    unit = (10 * usual_step(case)) ** 2
    return Draft(
        [case.corr_names[int(pair[0])]],
        lambda s: WarmNeighbour(int(pair[0]), int(pair[1]), way * s / unit),
        lambda s: {"gain": (way * s, "1")},
        1.0,
        300.0,
    )


class BreathingDelay(OnCurrent):
    """A corrector whose delay comes and goes with a slow cycle of its network."""

    def __init__(self, columns: Index, ticks: float, cycle: float) -> None:
        super().__init__(columns)
        self.ticks, self.cycle = ticks, cycle

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = [wanted.copy()] * 12
        self.memory = [wanted.copy(), *self.memory[:11]]
        busy = np.sin(2 * np.pi * row / self.cycle) > 0.7  # a quarter of the time
        late = min(self.ticks * busy, 10.0)
        whole = int(late)
        part = late - whole
        return (1 - part) * self.memory[whole] + part * self.memory[whole + 1]


@kind("x-breathing-delay", "actuator", known=False)
def breathing_delay(case: Conditions, rng: Rng) -> Draft:
    columns, cycle = one_or_cell(case, case.corr_names, rng, 1.0), rng.uniform(40, 200)
    return Draft(
        named(case.corr_names, columns),
        lambda s: BreathingDelay(columns, s, cycle),
        lambda s: {"delay": (s * case.period, "s")},
        1.0,
        10.0,
    )


class OrbitShaker(Nature):
    """A quadrupole that vibrates, its frequency pulled by where the beam passes it."""

    def __init__(self, shape: Array, kick: float, frequency: float) -> None:
        self.shape, self.kick, self.frequency = shape, kick, frequency

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.phase, self.still = 0.0, None
        self.length = float(np.linalg.norm(self.shape))

    def bend(self, row: int, orbit: Array, currents: Array) -> Array:
        place = float(self.shape @ orbit) / self.length
        if self.still is None:
            self.still = place
        pull = np.tanh((place - self.still) / 30e-6)
        self.phase += 2 * np.pi * self.frequency * (1 + 0.5 * pull)
        return orbit + self.shape * self.kick * np.sin(self.phase) * (1 + 0.7 * pull)


@kind("x-orbit-pulled-vibration", "disturbance", known=False)
def orbit_shaker(case: Conditions, rng: Rng) -> Draft:
    name, _, shape = source(case, rng)
    frequency = rng.uniform(0.05, 0.4)
    return Draft(
        [name],
        lambda s: OrbitShaker(shape, s, frequency),
        lambda s: {"kick": (s, "rad")},
        2e-8,
        1e-5,
    )


class AlternatingCoupling(OnCurrent):
    """An amplifier that is coupled by a capacitor: a setpoint leaks away and comes back."""

    def __init__(self, columns: Index, tau: float) -> None:
        super().__init__(columns)
        self.tau = tau

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            # The standing current is held by a supply of its own.
            self.memory, self.still = wanted.copy(), wanted.copy()
        self.memory = self.memory + (wanted - self.memory) * (1 - np.exp(-1 / self.tau))
        return wanted - 0.8 * (self.memory - self.still)


@kind("x-ac-coupled-corrector", "actuator", known=False)
def alternating(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.5)
    return Draft(
        named(case.corr_names, columns),
        lambda s: AlternatingCoupling(columns, 200 / s),
        lambda s: {"tau": (200 / s * case.period, "s")},
        1.0,
        60.0,
    )


class Overshoot(OnCurrent):
    """A bipolar supply that overshoots on the way up only."""

    def __init__(self, columns: Index, size: float) -> None:
        super().__init__(columns)
        self.size = size

    def drive(self, row: int, wanted: Array) -> Array:
        before = wanted if self.memory is None else self.memory
        self.memory = wanted.copy()
        return wanted + self.size * np.maximum(wanted - before, 0)


@kind("x-one-sided-overshoot", "actuator", known=False)
def overshoot(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Overshoot(columns, s),
        lambda s: {"share": (s, "1")},
        0.3,
        5.0,
    )


class WrongOrder(OnCurrent):
    """Every k-th tick the frame of a cell is written in reverse order of its channels."""

    def __init__(self, columns: Index, every: int) -> None:
        super().__init__(columns)
        self.every = every

    def drive(self, row: int, wanted: Array) -> Array:
        before = wanted if self.memory is None else self.memory
        self.memory = wanted.copy()
        if row % self.every:
            return wanted
        return before + (wanted - before)[::-1]


@kind("x-reversed-frames", "timing", known=False)
def reversed_frames(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 1.0)
    return Draft(
        named(case.corr_names, columns),
        lambda s: WrongOrder(columns, max(2, round(40 / s))),
        lambda s: {"every": (max(2, round(40 / s)), "1")},
        2.0,
        20.0,
    )


class WeakBus(Nature):
    """A cell's supplies share a bus: the more they all drive away from rest, the less each gets."""

    def __init__(self, columns: Index, size: float) -> None:
        self.columns, self.size = columns, size

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.still = None

    def currents(self, row: int, wanted: Array) -> Array:
        if self.still is None:
            self.still = wanted[self.columns].copy()
        away = wanted[self.columns] - self.still
        driven = wanted.copy()
        driven[self.columns] = self.still + away / (1 + self.size * np.sum(np.abs(away)))
        return driven


@kind("x-weak-bus", "actuator", known=False)
def weak_bus(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 1.0)
    unit = 30 * usual_step(case) * len(columns)
    return Draft(
        named(case.corr_names, columns),
        lambda s: WeakBus(columns, s / unit),
        lambda s: {"size": (s, "1")},
        0.3,
        100.0,
    )

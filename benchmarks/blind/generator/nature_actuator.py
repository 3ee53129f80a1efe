"""Correctors and the way to them, as nature makes them."""

from typing import Any

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_sensor import named, one_or_cell, sign
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class OnCurrent(Nature):
    """Something that correctors make of their setpoints."""

    def __init__(self, columns: Index) -> None:
        self.columns = columns

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.case, self.rng = case, rng
        self.memory: Any = None  # of each effect its own

    def drive(self, row: int, wanted: Array) -> Array:
        """Currents of the columns from the setpoints sent."""
        raise NotImplementedError

    def currents(self, row: int, wanted: Array) -> Array:
        driven = wanted.copy()
        driven[self.columns] = self.drive(row, wanted[self.columns])
        return driven


class Scaled(OnCurrent):
    def __init__(self, columns: Index, gain: float) -> None:
        super().__init__(columns)
        self.gain = gain

    def drive(self, row: int, wanted: Array) -> Array:
        return wanted * (1 + self.gain)


@kind("corrector-gain", "actuator")
def corrector_gain(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.corr_names, rng), sign(rng)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Scaled(columns, way * s),
        lambda s: {"gain": (way * s, "1")},
        0.15,
        0.95,
    )


@kind("corrector-polarity", "actuator", unstable=True)
def corrector_polarity(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.0)
    return Draft(
        named(case.corr_names, columns), lambda s: Scaled(columns, -2.0), lambda s: {}, 0.0, 0.0
    )


class Stuck(OnCurrent):
    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy()
        return self.memory


@kind("corrector-stuck", "actuator", unstable=True)
def corrector_stuck(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.0)
    return Draft(named(case.corr_names, columns), lambda s: Stuck(columns), lambda s: {}, 0.0, 0.0)


class Slew(OnCurrent):
    """A supply that drives its magnet at a limited rate, from the write to the reading."""

    def __init__(self, columns: Index, rate: float) -> None:
        super().__init__(columns)
        self.rate = rate

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), wanted.copy()
        before, here = self.memory
        period, delay = self.case.period, self.case.delay
        for aim, time in ((before, delay * period), (wanted, (1 - delay) * period)):
            here = here + np.clip(aim - here, -self.rate * time, self.rate * time)
        self.memory = wanted.copy(), here
        return here


def usual_step(case: Conditions) -> float:
    """Rough size of a loop's step of a setpoint [A]."""
    step = case.gain * np.sqrt(np.mean((case.controller * case.noise) ** 2) * len(case.noise))
    moves = np.diff(case.dither[:300], axis=0)
    return float(np.hypot(step, np.sqrt(np.mean(moves**2)) if moves.size else 0.0))


@kind("corrector-slew", "actuator")
def corrector_slew(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    step = usual_step(case) / case.period
    return Draft(
        named(case.corr_names, columns),
        lambda s: Slew(columns, step / s),
        lambda s: {"rate": (step / s, "A/s")},
        1.0,
        300.0,
    )


class Lag(OnCurrent):
    """First order in continuous time: the current of a coil, or the field behind a chamber."""

    def __init__(self, columns: Index, tau: float, tau2: float = 0.0) -> None:
        super().__init__(columns)
        self.taus = [tau] if not tau2 else [tau, tau2]

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), [wanted.copy() for _ in self.taus]
        before, states = self.memory
        period, delay = self.case.period, self.case.delay
        after = []
        for tau, state in zip(self.taus, states, strict=True):
            state = before + (state - before) * np.exp(-delay * period / tau)
            after.append(wanted + (state - wanted) * np.exp(-(1 - delay) * period / tau))
        self.memory = wanted.copy(), after
        return np.mean(after, axis=0)


@kind("corrector-lag", "actuator")
def corrector_lag(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.corr_names, rng, 0.4)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Lag(columns, s * case.period),
        lambda s: {"tau": (s * case.period, "s")},
        0.6,
        20.0,
    )


class Resonance(OnCurrent):
    """A supply that rings: ẍ + 2ζω ẋ + ω² x = ω² u, integrated in 40 steps per tick."""

    def __init__(self, columns: Index, turns: float, damping: float) -> None:
        super().__init__(columns)
        self.turns, self.damping = turns, damping

    def drive(self, row: int, wanted: Array) -> Array:
        if self.memory is None:
            self.memory = wanted.copy(), wanted.copy(), np.zeros_like(wanted)
        before, place, speed = self.memory
        omega, step = 2 * np.pi * self.turns, 1 / 40  # time in ticks
        for part in range(40):
            aim = before if (part + 0.5) * step < self.case.delay else wanted
            half = speed + step / 2 * (omega**2 * (aim - place) - 2 * self.damping * omega * speed)
            place = place + step * half
            speed = (half + step / 2 * omega**2 * (aim - place)) / (1 + step * self.damping * omega)
        self.memory = wanted.copy(), place, speed
        return place


@kind("corrector-resonance", "actuator")
def corrector_resonance(case: Conditions, rng: Rng) -> Draft:
    columns, damping = one_or_cell(case, case.corr_names, rng, 0.3), rng.uniform(0.15, 0.5)
    return Draft(
        named(case.corr_names, columns),
        lambda s: Resonance(columns, 1 / (s * 2 * np.pi), damping),
        lambda s: {
            "frequency": (1 / (s * 2 * np.pi * case.period), "Hz"),
            "damping": (damping, "1"),
        },
        0.4,
        1.6,
    )

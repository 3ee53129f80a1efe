"""Sensors and their noise, as nature makes them."""

from typing import Any

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class OnReading(Nature):
    """Something that BPMs make of what they see, by a function of row and values."""

    def __init__(self, columns: Index) -> None:
        self.columns = columns

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.case, self.rng = case, rng
        self.memory: Any = None  # of each effect its own

    def change(self, row: int, seen: Array) -> Array:
        """New values of the columns."""
        raise NotImplementedError

    def read(self, row: int, seen: Array) -> Array:
        told = seen.copy()
        told[self.columns] = self.change(row, seen[self.columns])
        return told


def one_or_cell(case: Conditions, names: list[str], rng: Rng, cell: float = 0.25) -> Index:
    """One column, or those of one plane of a cell."""
    plane = case.all_planes[int(rng.integers(len(case.all_planes)))]
    if rng.random() < cell:
        groups = [g for g in case.groups(names, plane).values() if len(g) > 1]
        return groups[int(rng.integers(len(groups)))]
    return np.array([int(rng.integers(len(names)))])


def named(names: list[str], columns: Index) -> list[str]:
    return [names[int(i)] for i in columns]


def sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


class Gain(OnReading):
    def __init__(self, columns: Index, gain: float) -> None:
        super().__init__(columns)
        self.gain = gain

    def change(self, row: int, seen: Array) -> Array:
        return seen * (1 + self.gain)


@kind("bpm-gain", "sensor")
def bpm_gain(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.bpm_names, rng), sign(rng)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Gain(columns, way * s),
        lambda s: {"gain": (way * s, "1")},
        0.05,
        0.9,
    )


class Roll(Nature):
    def __init__(self, pair: tuple[int, int], angle: float) -> None:
        self.pair, self.angle = pair, angle

    def read(self, row: int, seen: Array) -> Array:
        i, j = self.pair
        told = seen.copy()
        c, s = np.cos(self.angle), np.sin(self.angle)
        told[i], told[j] = c * seen[i] + s * seen[j], c * seen[j] - s * seen[i]
        return told


@kind("bpm-roll", "sensor", planes="xy")
def bpm_roll(case: Conditions, rng: Rng) -> Draft:
    i, way = int(rng.integers(len(case.bpms))), sign(rng)
    return Draft(
        [case.bpm_names[i]],
        lambda s: Roll((i, i + len(case.bpms)), way * s),
        lambda s: {"angle": (way * s, "rad")},
        0.05,
        0.7,
    )


class Course(Nature):
    """Adds a course in time to readings."""

    def __init__(self, columns: Index, course: Array) -> None:
        self.columns, self.course = columns, course

    def read(self, row: int, seen: Array) -> Array:
        told = seen.copy()
        told[self.columns] += self.course[row]
        return told


@kind("bpm-offset", "sensor", onset="inside")
def bpm_offset(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.bpm_names, rng, 0.15), sign(rng)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Course(columns, np.full(case.rows, way * s)),
        lambda s: {"offset": (way * s, "m")},
        2e-6,
        2e-4,
    )


@kind("bpm-drift", "sensor", onset="start")
def bpm_drift(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.bpm_names, rng), sign(rng)
    time = np.arange(case.rows) * case.period
    slow = time[-1] * rng.uniform(2, 6)  # it warms up: nearly a straight line, not quite
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Course(columns, way * s * slow * (1 - np.exp(-time / slow))),
        lambda s: {"rate": (way * s * float(np.mean(np.exp(-time / slow))), "m/s")},
        2e-7 / case.period * 0.1,
        1e-4,
    )


class Pickup(OnReading):
    """Four buttons, difference over sum: flattens like a tanh, or bends to one side."""

    def __init__(self, columns: Index, cubic: float, square: float) -> None:
        super().__init__(columns)
        self.cubic, self.square = cubic, square

    def change(self, row: int, seen: Array) -> Array:
        if not self.cubic:
            return seen + self.square * seen**2
        width = np.sqrt(1 / (3 * abs(self.cubic)))
        return width * np.tanh(seen / width) + self.square * seen**2


@kind("bpm-nonlinearity", "sensor")
def bpm_nonlinearity(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.0)
    even = rng.random() < 0.5
    way = sign(rng) if even else -1.0
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Pickup(columns, 0.0 if even else way * s * 1e4, way * s if even else 0.0),
        lambda s: {"quadratic": (way * s, "1/m")} if even else {"cubic": (way * s * 1e4, "1/m²")},
        300.0,
        2e4 if even else 1e5,
    )


class LowPass(OnReading):
    """A first-order filter in continuous time; the orbit jumps when the setpoints are written."""

    def __init__(self, columns: Index, tau: float) -> None:
        super().__init__(columns)
        self.tau = tau

    def change(self, row: int, seen: Array) -> Array:
        if self.memory is None:
            self.memory = seen.copy(), seen.copy()
        before, told = self.memory
        period, delay = self.case.period, self.case.delay
        told = before + (told - before) * np.exp(-delay * period / self.tau)
        told = seen + (told - seen) * np.exp(-(1 - delay) * period / self.tau)
        self.memory = seen.copy(), told
        return told


@kind("bpm-lowpass", "sensor")
def bpm_lowpass(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.3)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: LowPass(columns, s * case.period),
        lambda s: {"tau": (s * case.period, "s")},
        0.6,
        20.0,
    )


class Late(OnReading):
    """Readings that are told a while later; between two readings the orbit is on its way."""

    def __init__(self, columns: Index, ticks: float) -> None:
        super().__init__(columns)
        self.ticks = ticks

    def change(self, row: int, seen: Array) -> Array:
        whole = int(np.floor(self.ticks))
        if self.memory is None:
            self.memory = [seen.copy()] * (whole + 2)
        self.memory = [seen.copy(), *self.memory[: whole + 1]]
        part = self.ticks - whole
        return (1 - part) * self.memory[whole] + part * self.memory[whole + 1]


@kind("bpm-latency", "sensor")
def bpm_latency(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.4)
    ticks = int(rng.integers(1, 3))
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Late(columns, ticks),
        lambda s: {"ticks": (ticks, "1")},
        0.0,
        0.0,
    )


class Frozen(OnReading):
    def change(self, row: int, seen: Array) -> Array:
        if self.memory is None:
            self.memory = seen.copy()
        return self.memory


@kind("bpm-stuck", "sensor", onset="inside", unstable=True)
def bpm_stuck(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.0)
    return Draft(named(case.bpm_names, columns), lambda s: Frozen(columns), lambda s: {}, 0.0, 0.0)


class Swapped(Nature):
    def __init__(self, pair: Index, on: str) -> None:
        self.pair, self.on = pair, on

    def read(self, row: int, seen: Array) -> Array:
        return self._swap(seen) if self.on == "bpm" else seen

    def currents(self, row: int, wanted: Array) -> Array:
        return self._swap(wanted) if self.on == "corrector" else wanted

    def _swap(self, values: Array) -> Array:
        swapped = values.copy()
        swapped[self.pair] = values[self.pair[::-1]]
        return swapped


def neighbours(case: Conditions, names: list[str], rng: Rng) -> Index:
    """Two columns of one plane and one cell, as cables get swapped."""
    plane = case.all_planes[int(rng.integers(len(case.all_planes)))]
    groups = [g for g in case.groups(names, plane).values() if len(g) > 1]
    return np.sort(rng.choice(groups[int(rng.integers(len(groups)))], 2, replace=False))


@kind("bpm-swap", "sensor", unstable=True)
def bpm_swap(case: Conditions, rng: Rng) -> Draft:
    pair = neighbours(case, case.bpm_names, rng)
    return Draft(
        named(case.bpm_names, pair), lambda s: Swapped(pair, "bpm"), lambda s: {}, 0.0, 0.0
    )


@kind("bpm-polarity", "sensor", unstable=True)
def bpm_polarity(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.0)
    return Draft(
        named(case.bpm_names, columns), lambda s: Gain(columns, -2.0), lambda s: {}, 0.0, 0.0
    )


@kind("bpm-current", "sensor", onset="start")
def bpm_current(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.bpm_names, rng), sign(rng)
    # The electronics follow the logarithm of the signal; over a top-up it is nearly a line.
    course = case.current.mean() * np.log(case.current / case.current.mean())
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Course(columns, way * s * course),
        lambda s: {"slope": (way * s, "m/A")},
        1e-3,
        1.0,
    )

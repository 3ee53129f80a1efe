"""Correctors that hear each other, and the way from the loop to them."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_actuator import OnCurrent
from benchmarks.blind.generator.nature_sensor import Swapped, named, neighbours, sign
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


@kind("corrector-swap", "actuator", unstable=True)
def corrector_swap(case: Conditions, rng: Rng) -> Draft:
    pair = neighbours(case, case.corr_names, rng)
    return Draft(
        named(case.corr_names, pair), lambda s: Swapped(pair, "corrector"), lambda s: {}, 0.0, 0.0
    )


class Leak(Nature):
    """A share of one corrector's current drives another."""

    def __init__(self, giver: int, taker: int, share: float) -> None:
        self.giver, self.taker, self.share = giver, taker, share

    def currents(self, row: int, wanted: Array) -> Array:
        driven = wanted.copy()
        driven[self.taker] += self.share * wanted[self.giver]
        return driven


@kind("corrector-crosstalk", "actuator")
def corrector_crosstalk(case: Conditions, rng: Rng) -> Draft:
    pair, way = rng.permutation(neighbours(case, case.corr_names, rng)), sign(rng)
    giver, taker = int(pair[0]), int(pair[1])
    return Draft(
        named(case.corr_names, pair),
        lambda s: Leak(giver, taker, way * s),
        lambda s: {"share": (way * s, "1")},
        0.1,
        1.0,
    )


class Turned(Nature):
    def __init__(self, pair: tuple[int, int], ratio: float, angle: float) -> None:
        self.pair, self.ratio, self.angle = pair, ratio, angle

    def currents(self, row: int, wanted: Array) -> Array:
        i, j = self.pair
        driven = wanted.copy()
        c, s = np.cos(self.angle), np.sin(self.angle)
        # A rotation of the kicks; the currents of both planes differ by their calibrations.
        driven[i] = c * wanted[i] - s * wanted[j] / self.ratio
        driven[j] = c * wanted[j] + s * wanted[i] * self.ratio
        return driven


@kind("corrector-roll", "actuator", planes="xy")
def corrector_roll(case: Conditions, rng: Rng) -> Draft:
    i, way = int(rng.integers(len(case.correctors))), sign(rng)
    ring = case.lattice.ring
    ratio = float(ring.calibration("x")[i] / ring.calibration("y")[i])
    return Draft(
        [case.corr_names[i]],
        lambda s: Turned((i, i + len(case.correctors)), ratio, way * s),
        lambda s: {"angle": (way * s, "rad")},
        0.15,
        1.2,
    )


class LateWrite(OnCurrent):
    """Everything written acts a while later."""

    def __init__(self, columns: Index, ticks: float) -> None:
        super().__init__(columns)
        self.ticks = ticks

    def drive(self, row: int, wanted: Array) -> Array:
        whole = int(np.floor(self.ticks))
        if self.memory is None:
            self.memory = [wanted.copy()] * (whole + 2)
        self.memory = [wanted.copy(), *self.memory[: whole + 1]]
        part = self.ticks - whole
        return (1 - part) * self.memory[whole] + part * self.memory[whole + 1]


@kind("loop-delay", "timing")
def loop_delay(case: Conditions, rng: Rng) -> Draft:
    columns = np.arange(len(case.corr_names))
    return Draft(
        [],
        lambda s: LateWrite(columns, s),
        lambda s: {"ticks": (s, "1")},
        0.1,
        2.0,
    )


class Missed(Nature):
    """Now and then nothing that was sent arrives; the next tick sends absolute setpoints."""

    def __init__(self, chance: float) -> None:
        self.chance = chance

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.luck, self.memory = rng.random(case.rows), None

    def currents(self, row: int, wanted: Array) -> Array:
        if self.memory is None or self.luck[row] >= self.chance:
            self.memory = wanted.copy()
        return self.memory


@kind("missed-write", "timing", onset="start")
def missed_write(case: Conditions, rng: Rng) -> Draft:
    return Draft(
        [],
        lambda s: Missed(s),
        lambda s: {"probability": (s, "1")},
        0.01,
        0.3,
        law="rare",
        least=0.003,
    )

"""Sensors of no library: the diagnosis is to say that it does not know them."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_sensor import OnReading, named, neighbours, one_or_cell, sign
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class DroppedBit(OnReading):
    """A converter one of whose bits is always 0."""

    def __init__(self, columns: Index, bit: float) -> None:
        super().__init__(columns)
        self.bit = bit

    def change(self, row: int, seen: Array) -> Array:
        return seen - self.bit * (np.floor(seen / self.bit) % 2)


@kind("x-bpm-dropped-bit", "sensor", known=False)
def dropped_bit(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.0)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: DroppedBit(columns, s),
        lambda s: {"bit": (s, "m")},
        1e-6,
        1e-4,
    )


class SumGain(OnReading):
    """The reading's gain follows the sum signal, which follows beam current and position."""

    def __init__(self, columns: Index, size: float) -> None:
        super().__init__(columns)
        self.size = size

    def change(self, row: int, seen: Array) -> Array:
        if self.memory is None:
            self.memory = seen.copy()
        beam = self.case.current[row] / self.case.current.mean() - 1
        away = (seen - self.memory) / 20e-6
        return seen * (1 + self.size * (30 * beam + np.abs(away) ** 1.5))


@kind("x-bpm-sum-signal-gain", "sensor", known=False)
def sum_gain(case: Conditions, rng: Rng) -> Draft:
    columns, way = one_or_cell(case, case.bpm_names, rng, 0.0), sign(rng)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: SumGain(columns, way * s),
        lambda s: {"size": (way * s, "1")},
        0.05,
        2.0,
    )


class Attenuator(OnReading):
    """A switched attenuator: a gain and an offset of its own in every range of the beam."""

    def __init__(self, columns: Index, size: float, steps: Array) -> None:
        super().__init__(columns)
        self.size, self.steps = size, steps

    def change(self, row: int, seen: Array) -> Array:
        current = self.case.current
        low, high = current.min(), current.max()
        stage = int(3.999 * (current[row] - low) / (high - low))
        return seen * (1 + self.size * 0.02 * self.steps[0, stage]) + (
            self.size * 1e-6 * self.steps[1, stage]
        )


@kind("x-bpm-attenuator", "sensor", onset="start", known=False)
def attenuator(case: Conditions, rng: Rng) -> Draft:
    columns, steps = one_or_cell(case, case.bpm_names, rng, 0.0), rng.standard_normal((2, 4))
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Attenuator(columns, s, steps),
        lambda s: {"size": (s, "1")},
        1.0,
        100.0,
    )


class LateLeak(Nature):
    """A BPM that hears its neighbour, through a filter."""

    def __init__(self, giver: int, taker: int, share: float, keep: float) -> None:
        self.giver, self.taker, self.share, self.keep = giver, taker, share, keep

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.memory = None

    def read(self, row: int, seen: Array) -> Array:
        if self.memory is None:
            self.memory = seen[self.giver]
        self.memory = self.keep * self.memory + (1 - self.keep) * seen[self.giver]
        told = seen.copy()
        told[self.taker] += self.share * self.memory
        return told


@kind("x-bpm-late-crosstalk", "sensor", known=False)
def late_leak(case: Conditions, rng: Rng) -> Draft:
    pair, way = rng.permutation(neighbours(case, case.bpm_names, rng)), sign(rng)
    keep = rng.uniform(0.6, 0.9)
    return Draft(
        [case.bpm_names[int(pair[1])]],
        lambda s: LateLeak(int(pair[0]), int(pair[1]), way * s, keep),
        lambda s: {"share": (way * s, "1")},
        0.1,
        3.0,
    )


class Beating(Nature):
    """A crate whose BPMs take turns in sampling: every second reading of theirs is the mean of two.

    The gain of an even tick differs from that of an odd one, and grows with the step.
    """

    def __init__(self, columns: Index, size: float) -> None:
        self.columns, self.size = columns, size

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.before = None

    def read(self, row: int, seen: Array) -> Array:
        before = seen if self.before is None else self.before
        self.before = seen
        told = seen.copy()
        if row % 2:
            told[self.columns] += self.size * (before - seen)[self.columns]
        return told


@kind("x-alternate-averaging", "sensor", known=False)
def alternate_averaging(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 1.0)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Beating(columns, s),
        lambda s: {"share": (s, "1")},
        0.1,
        1.0,
    )

"""Noise of readings, as nature makes it."""

import numpy as np

from benchmarks.blind.generator.conditions import Conditions
from benchmarks.blind.generator.draft import Draft, kind
from benchmarks.blind.generator.machine import Nature
from benchmarks.blind.generator.nature_sensor import named, one_or_cell
from benchmarks.blind.generator.rings import Array, Index

Rng = np.random.Generator


class Louder(Nature):
    def __init__(self, columns: Index, factor: float) -> None:
        self.columns, self.factor = columns, factor

    def noise(self, noise: Array) -> Array:
        louder = noise.copy()
        louder[:, self.columns] *= self.factor
        return louder


@kind("noise-level", "noise")
def noise_level(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.3)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Louder(columns, np.sqrt(1 + s**2)),
        lambda s: {"factor": (float(np.sqrt(1 + s**2)), "1")},
        0.5,
        20.0,
        law="random",
    )


class Common(Nature):
    """Noise that a crate's BPMs have in common; each one's total stays as it was."""

    def __init__(self, columns: Index, share: float) -> None:
        self.columns, self.share = columns, share

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.level = case.noise[self.columns]
        self.common = rng.standard_normal(case.rows)

    def noise(self, noise: Array) -> Array:
        mixed = noise.copy()
        own = np.sqrt(1 - self.share) * noise[:, self.columns]
        mixed[:, self.columns] = own + np.outer(self.common, np.sqrt(self.share) * self.level)
        return mixed


@kind("noise-correlated", "noise")
def noise_correlated(case: Conditions, rng: Rng) -> Draft:
    plane = case.all_planes[int(rng.integers(len(case.all_planes)))]
    groups = [g for g in case.groups(case.bpm_names, plane).values() if len(g) > 1]
    columns = groups[int(rng.integers(len(groups)))]
    count = len(columns)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Common(columns, s),
        lambda s: {"rms": (float(np.sqrt(s) * case.noise[columns].mean()), "m")},
        0.2,
        0.95,
        law="random",
        # −½ log det of the correlation matrix, per row
        closed=lambda s: -0.5 * ((count - 1) * np.log1p(-s) + np.log1p((count - 1) * s)),
    )


class Coloured(Nature):
    """Noise through the filter of its electronics, in continuous time; the same total."""

    def __init__(self, columns: Index, memory: float) -> None:
        self.columns, self.keep = columns, memory

    def noise(self, noise: Array) -> Array:
        coloured = noise.copy()
        fresh = np.sqrt(1 - self.keep**2) * noise[:, self.columns]
        for row in range(1, len(noise)):
            coloured[row, self.columns] = self.keep * coloured[row - 1, self.columns] + fresh[row]
        return coloured


@kind("noise-coloured", "noise", onset="start")
def noise_coloured(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.4)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Coloured(columns, s),
        lambda s: {"correlation": (s, "1")},
        0.3,
        0.97,
        law="random",
        closed=lambda s: -0.5 * len(columns) * np.log1p(-(s**2)),
    )


class Tails(Nature):
    """Student's t instead of Gauss, of the same variance where it has one; spikes by nature."""

    def __init__(self, columns: Index, size: float) -> None:
        self.columns, self.size = columns, size

    def bind(self, case: Conditions, rng: Rng) -> None:
        self.hits = rng.random((case.rows, len(self.columns))) < 0.02
        self.spikes = rng.standard_t(3, size=self.hits.shape) / np.sqrt(3)
        self.level = case.noise[self.columns]

    def noise(self, noise: Array) -> Array:
        spiky = noise.copy()
        spiky[:, self.columns] += self.size * self.level * self.hits * self.spikes
        return spiky


@kind("noise-tails", "noise", onset="start")
def noise_tails(case: Conditions, rng: Rng) -> Draft:
    columns = one_or_cell(case, case.bpm_names, rng, 0.4)
    return Draft(
        named(case.bpm_names, columns),
        lambda s: Tails(columns, s),
        lambda s: {"probability": (0.02, "1"), "amplitude": (s * float(case.noise[0]), "m")},
        5.0,
        300.0,
        law="spikes",
    )

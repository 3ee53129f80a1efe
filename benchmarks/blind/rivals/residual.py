"""The naive one-step residual of a record, and sums that the simple methods need."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.physics.optics import green
from orbitfb.physics.places import Plane, Ring, split

Array = NDArray[np.float64]


@dataclass(eq=False)
class Naive:
    """y' − y − R a of a record, SI.

    Args:
        arrays: Of the record.
        ring: Whose names the devices have; None: unknown.
    """

    arrays: dict[str, NDArray[Any]]
    ring: Ring | None

    @cached_property
    def response(self) -> Array:
        return self.arrays["model_R"] * 1e-3

    @cached_property
    def action(self) -> Array:
        return self.arrays["action"]

    @cached_property
    def predicted(self) -> Array:
        """R a."""
        return self.action @ self.response.T

    @cached_property
    def rest(self) -> Array:
        step = (self.arrays["next_orbit"] - self.arrays["orbit"]) * 1e-3
        return step - self.predicted

    @cached_property
    def level(self) -> Array:
        """Robust spread of the rest, by BPM."""
        middle = np.median(np.abs(self.rest - np.median(self.rest, axis=0)), axis=0)
        return np.maximum(middle / 0.6745, 1e-12)

    @cached_property
    def white(self) -> Array:
        return self.rest / self.level

    def row_gains(self) -> Array:
        """Gain of χ²/2 by a gain of every BPM."""
        regressor = self.predicted / self.level
        return _gain(np.sum(self.white * regressor, axis=0), np.sum(regressor**2, axis=0))

    def column_gains(self) -> Array:
        """Gain of χ²/2 by a gain of every corrector."""
        columns = self.response / self.level[:, None]
        score = np.sum((self.white @ columns) * self.action, axis=0)
        return _gain(score, np.sum(columns**2, axis=0) * np.sum(self.action**2, axis=0))

    def quadrupole_gains(self) -> Array:
        """Gain of χ²/2 by a gradient error of every quadrupole; empty for an unknown ring."""
        if self.ring is None:
            return np.zeros(0)
        quads = self.ring.places("QUAD")
        score, power = np.zeros(len(quads)), np.zeros(len(quads))
        for plane, rows, columns in self.planes():
            sign = -1.0 if plane == "x" else 1.0
            back = green(self.ring, self.ring.places("BPM"), quads, plane) * sign
            back = back / self.level[rows, None]
            to = green(self.ring, quads, self.ring.places("COR"), plane)
            at = self.action[:, columns] @ (to * self.ring.calibration(plane)).T
            score += np.sum((self.white[:, rows] @ back) * at, axis=0)
            power += np.sum(back**2, axis=0) * np.sum(at**2, axis=0)
        return _gain(score, power)

    def planes(self) -> list[tuple[Plane, slice, slice]]:
        """Planes with their columns of BPMs and of correctors."""
        meant = json.loads(str(self.arrays["meta"]))
        names = split(meant.get("planes") or meant.get("plane") or "x")
        n, m = (size // len(names) for size in self.response.shape)
        return [
            (p, slice(k * n, (k + 1) * n), slice(k * m, (k + 1) * m)) for k, p in enumerate(names)
        ]


def _gain(score: Array, power: Array) -> Array:
    return score**2 / np.maximum(power, 1e-300) / 2


def read(record: Path, files: tuple[Path, Path] | None) -> Naive:
    """Read a record; its ring counts if it knows the names."""
    with np.load(record, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    ring = Ring.load(*(files or (None, None)))
    return Naive(arrays, ring if str(arrays["bpm_names"][0]) in ring.table.name else None)

"""A measured response: a rectangular block for every plane of reading and kick."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices, Plane, Ring, plane_row

Pair = tuple[Plane, Plane]
"""Plane of the readings and plane of the kicks."""

PLANES: tuple[Plane, Plane] = ("x", "y")
CROSS: tuple[Pair, Pair] = (("x", "y"), ("y", "x"))


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A measured response matrix, block by block; planes may have other devices.

    Args:
        bpms: Of every plane, places in the table, shape (n_p,).
        correctors: Of every plane, places in the table, shape (m_p,).
        response: Of every pair of planes that was measured, shape (n, m) [m/rad]; NaN where not.
        sigma: Standard deviation of the noise, the same shapes [m/rad]; NaN where not known.
        dispersion: Measured horizontal dispersion at the BPMs, shape (n_x,) [m]; None: not given.
        dispersion_sigma: Its standard deviation, one number [m]; NaN where not known.
    """

    bpms: Mapping[Plane, Indices]
    correctors: Mapping[Plane, Indices]
    response: Mapping[Pair, Matrix]
    sigma: Mapping[Pair, Matrix]
    dispersion: Vector | None = None
    dispersion_sigma: float = float("nan")

    @property
    def planes(self) -> tuple[Plane, ...]:
        """Planes whose own block was measured."""
        return tuple(plane for plane in PLANES if (plane, plane) in self.response)

    def without(self, place: int, planes: tuple[Plane, ...]) -> "Measured":
        """Leave out a BPM or corrector: what it read or kicked was not measured.

        Args:
            place: In the table.
            planes: In which it is left out.
        """
        response = {pair: matrix.copy() for pair, matrix in self.response.items()}
        eta = None if self.dispersion is None else self.dispersion.copy()
        for (read, driven), matrix in response.items():
            if read in planes:
                matrix[self.bpms[read] == place] = np.nan
            if driven in planes:
                matrix[:, self.correctors[driven] == place] = np.nan
        if eta is not None and "x" in planes:
            eta[self.bpms["x"] == place] = np.nan
        return replace(self, response=response, dispersion=eta)

    def at_devices_of(self, other: "Measured") -> dict[Plane, Matrix]:
        """Give the own blocks in the order of another measurement's devices, NaN where it has more.

        Args:
            other: Whose devices count.
        """
        found: dict[Plane, Matrix] = {}
        for plane in other.planes:
            matrix = np.full((len(other.bpms[plane]), len(other.correctors[plane])), np.nan)
            if (plane, plane) in self.response:
                mine, rows, _ = np.intersect1d(
                    self.bpms[plane], other.bpms[plane], return_indices=True
                )
                its, columns, _ = np.intersect1d(
                    self.correctors[plane], other.correctors[plane], return_indices=True
                )
                to = np.ix_(
                    np.searchsorted(other.bpms[plane], mine),
                    np.searchsorted(other.correctors[plane], its),
                )
                matrix[to] = self.response[plane, plane][np.ix_(rows, columns)]
            found[plane] = matrix
        return found

    def known_in(self, model: Mapping[Plane, Matrix]) -> "Measured":
        """Leave out what a model does not have: its elements were not measured.

        Args:
            model: Of every plane, shape (n, m) [m/rad]; NaN where it has none.
        """
        response = dict(self.response)
        for plane, matrix in model.items():
            own = response[plane, plane]
            response[plane, plane] = np.where(np.isfinite(matrix), own, np.nan)
        return replace(self, response=response)

    @property
    def has_cross(self) -> bool:
        """Whether a block of the other plane was measured."""
        return any(pair in self.response for pair in CROSS)

    @property
    def noise_known(self) -> bool:
        """Whether the noise of every own block is known."""
        return all(np.isfinite(self.sigma[plane, plane]).any() for plane in self.planes)


def bpm_labels(measured: Measured, ring: Ring, plane: Plane) -> tuple[str, ...]:
    """Name the readings of a plane NAME:plane."""
    return tuple(f"{ring.table.name[int(i)]}:{plane}" for i in measured.bpms[plane])


def corrector_labels(measured: Measured, ring: Ring, plane: Plane) -> tuple[str, ...]:
    """Name the correctors of a plane NAME:plane."""
    return tuple(f"{ring.table.name[int(j)]}:{plane}" for j in measured.correctors[plane])


def from_setpoints(
    ring: Ring,
    bpms: Mapping[Plane, Indices],
    correctors: Mapping[Plane, Indices],
    response: Mapping[Pair, Matrix],
    sigma: Mapping[Pair, Matrix],
    dispersion: Vector | None = None,
) -> Measured:
    """Make a measured response of matrices per ampere, by the calibrations of the table.

    Args:
        ring: The ring.
        bpms: Of every plane, places in the table.
        correctors: Of every plane, places in the table.
        response: Of every pair of planes, shape (n, m) [m/A].
        sigma: The same of the noise [m/A].
        dispersion: Measured, shape (n_x,) [m].
    """
    per_ampere = {
        plane: ring.table.calibration[plane_row(plane), places]
        for plane, places in correctors.items()
    }
    return Measured(
        bpms,
        correctors,
        {pair: matrix / per_ampere[pair[1]] for pair, matrix in response.items()},
        {pair: matrix / np.abs(per_ampere[pair[1]]) for pair, matrix in sigma.items()},
        dispersion,
    )

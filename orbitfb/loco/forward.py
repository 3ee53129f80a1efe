"""The model that a measured response is fitted by, and what its parameters change of it.

    M_ij = (1 + g_i) (1 + C + c_j) G'_ij(ΔK/K) + (1 + g_i) η'_i e_j     (e_j in x alone)

g are gains of readings, c calibrations of correctors, C the scale of all of a plane, e what a
corrector changes of the energy beyond the table, η' and G' dispersion and response of the optics
with the errors.
"""

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.loco.measured import Measured
from orbitfb.loco.normal import Piece, normal_equations
from orbitfb.loco.optics import SIGN, PlaneOptics, RingOptics
from orbitfb.loco.parameters import Groups, Noise
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane


class PlaneModel:
    """The own blocks of a measured response as a function of the parameters.

    Args:
        optics: The ring at the devices of the measurement.
        measured: The measurement.
    """

    def __init__(self, optics: RingOptics, measured: Measured) -> None:
        self.optics, self.measured = optics, measured
        self.groups = Groups.for_planes(measured, len(optics.quadrupoles))
        self.there = {
            plane: np.isfinite(measured.response[plane, plane]) for plane in measured.planes
        }

    def response(self, theta: Vector, optics: dict[Plane, PlaneOptics], plane: Plane) -> Matrix:
        """Response of a plane as it is read, shape (n, m) [m/rad]."""
        of, its = self.groups.of, optics[plane]
        gain = 1.0 + theta[of[f"gain:{plane}"]]
        kick = 1.0 + theta[of[f"scale:{plane}"]] + theta[of[f"calibration:{plane}"]]
        orbit = self.orbit(theta, its, plane, kick)
        return gain[:, None] * orbit

    def residuals(self, theta: Vector, optics: dict[Plane, PlaneOptics]) -> dict[Plane, Matrix]:
        """What the model leaves of the measurement, zero where nothing was measured [m/rad]."""
        return {
            plane: np.where(
                self.there[plane],
                self.measured.response[plane, plane] - self.response(theta, optics, plane),
                0.0,
            )
            for plane in self.measured.planes
        }

    def rf_residual(
        self, theta: Vector, optics: dict[Plane, PlaneOptics]
    ) -> tuple[Vector, Vector, Vector]:
        """Weighted residual of the dispersion, its weight and the orbit at factor one."""
        measured = self.measured.dispersion
        if measured is None:
            raise RingError("no dispersion was measured")
        its = optics["x"]
        read = (1.0 + theta[self.groups.of["gain:x"]]) * its.dispersion
        left = measured - (1.0 + theta[self.groups.of["rf"]]) * read
        there = np.isfinite(left)
        sigma = self.measured.dispersion_sigma
        if not np.isfinite(sigma):
            sigma = max(float(TO_SIGMA * np.median(np.abs(left[there]))), 1e-6)
        weight = np.where(there, 1.0 / sigma, 0.0)
        return np.where(there, left, 0.0) * weight, weight, read

    def normal(
        self, theta: Vector, optics: dict[Plane, PlaneOptics], noise: dict[Plane, Noise]
    ) -> tuple[Matrix, Vector]:
        """Information and pull of all parameters for a small step from theta."""
        of = self.groups.of
        residuals = self.residuals(theta, optics)
        pieces = [
            self._piece(theta, optics[plane], residuals[plane], noise[plane], plane)
            for plane in self.measured.planes
        ]
        matrix, pull = normal_equations(pieces, self.groups.size)
        for plane in self.measured.planes:  # the scale moves all calibrations of a plane at once
            scale, own = of[f"scale:{plane}"], of[f"calibration:{plane}"]
            matrix[scale] = matrix[own].sum(axis=0)
            matrix[:, scale] = matrix[:, own].sum(axis=1, keepdims=True)
            pull[scale] = pull[own].sum()
        if "rf" in of:
            self._add_rf(theta, optics, matrix, pull)
        return matrix, pull

    def orbit(self, theta: Vector, its: PlaneOptics, plane: Plane, kick: Vector) -> Matrix:
        """Orbit at the BPMs before their gain, shape (n, m) [m/rad]."""
        of = self.groups.of
        by_kick = its.own + its.turned_rows * theta[of[f"row-phase:{plane}"]][:, None]
        by_kick = by_kick + its.turned_columns * theta[of[f"column-phase:{plane}"]]
        orbit = by_kick * kick
        if plane == "x":
            orbit = orbit + np.outer(its.dispersion, theta[of["energy:x"]])
        return orbit

    def _piece(
        self, theta: Vector, its: PlaneOptics, residual: Matrix, noise: Noise, plane: Plane
    ) -> Piece:
        of = self.groups.of
        gain = 1.0 + theta[of[f"gain:{plane}"]]
        kick = 1.0 + theta[of[f"scale:{plane}"]] + theta[of[f"calibration:{plane}"]]
        orbit = self.orbit(theta, its, plane, kick)
        by_kick = its.own + its.turned_columns * theta[of[f"column-phase:{plane}"]]
        by_kick = by_kick + its.turned_rows * theta[of[f"row-phase:{plane}"]][:, None]
        columns = [
            (gain[:, None] * by_kick, of[f"calibration:{plane}"]),
            (gain[:, None] * its.turned_columns * kick, of[f"column-phase:{plane}"]),
        ]
        if plane == "x":
            read = np.repeat((gain * its.dispersion)[:, None], len(kick), axis=1)
            columns.append((read, of["energy:x"]))
        return Piece(
            residual,
            noise.kept,
            noise.rows**-2.0,
            noise.columns**-2.0,
            [
                (orbit, of[f"gain:{plane}"]),
                (gain[:, None] * its.turned_rows * kick, of[f"row-phase:{plane}"]),
            ],
            columns,
            gain[:, None] * its.left * (SIGN[plane] * self.optics.strength),
            its.right * kick,
            of["gradient"],
        )

    def _add_rf(
        self, theta: Vector, optics: dict[Plane, PlaneOptics], matrix: Matrix, pull: Vector
    ) -> None:
        of, its = self.groups.of, optics["x"]
        residual, weight, read = self.rf_residual(theta, optics)
        factor = 1.0 + theta[of["rf"]]
        gain = 1.0 + theta[of["gain:x"]]
        index = np.concatenate([of["rf"], of["gradient"]])
        push = its.left_momentum * (SIGN["x"] * self.optics.strength * its.at_quadrupoles)
        dense = np.column_stack([read, factor * gain[:, None] * push]) * weight[:, None]
        own = factor * its.dispersion * weight
        gains = of["gain:x"]
        matrix[np.ix_(index, index)] += dense.T @ dense
        matrix[gains, gains] += own**2
        matrix[np.ix_(gains, index)] += own[:, None] * dense
        matrix[np.ix_(index, gains)] += (own[:, None] * dense).T
        pull[index] += dense.T @ residual
        pull[gains] += own * residual

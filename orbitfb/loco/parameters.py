"""Parameters of the fit in the planes, their healthy spreads, and what a fit is."""

from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.loco.measured import Measured
from orbitfb.loco.optics import PlaneOptics
from orbitfb.loco.posterior import Posterior
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Indices, Plane

STANDS_OUT = 5.0
"""Standard deviations from which a device stands out; of 1000 healthy ones 0.0006 do by chance."""

OUTLIER = 10.0
"""Robust standard deviations of row and column from which one element counts as an outlier."""

MOST_NOISE = 3.0
"""Most by which noise that is not known may differ from the median row or column [1]: on measured
rings it differs by 2 to 7, and a row that the optics do not reach looks noisy, too."""

BELIEVED = 0.5
"""Share of the stated noise below which the fit leaves so little that the statement cannot be true
[1]: a typical row has 50 columns and more, so its noise is known to 10 %."""

MOST_GRADIENT = 0.02
"""Largest healthy spread of gradients [1]: beyond 2 % nobody can run a ring by its model."""

LEAST_SPREAD = {
    "gain": 1e-3,
    "calibration": 1e-3,
    "row-phase": 1e-4,
    "column-phase": 1e-4,
    "energy": 1e-6,
    "gradient": 1e-5,
}
"""Smallest healthy spread of a group [1], of energies [1/rad]: far below what rings have."""

FIRST_SPREAD = {
    "gain": 0.05,
    "calibration": 0.05,
    "row-phase": 1e-3,
    "column-phase": 1e-3,
    "energy": 1e-3,
    "gradient": 0.01,
}
"""Spread with which the fit begins: gains of 4-8 % and gradients of 1 % on measured rings."""


def centred(name: str) -> bool:
    """Whether the common part of a group is gauge: gains against calibrations, rows and columns."""
    return name.startswith(("gain", "calibration", "row", "column"))


@dataclass(frozen=True, slots=True, eq=False)
class Groups:
    """Where the parameters stand.

    Args:
        size: Of all.
        of: Parameters of a group by its name: `gain:x`, `calibration:y`, `scale:x`, `energy:x`,
            `gradient`, `rf`.
    """

    size: int
    of: dict[str, Indices]

    @classmethod
    def for_planes(cls, measured: Measured, quadrupoles: int) -> "Groups":
        """Lay out the parameters of the planes that were measured."""
        names: list[tuple[str, int]] = []
        for plane in measured.planes:
            names.append((f"gain:{plane}", len(measured.bpms[plane])))
            names.append((f"calibration:{plane}", len(measured.correctors[plane])))
            names.append((f"scale:{plane}", 1))
            names.append((f"row-phase:{plane}", len(measured.bpms[plane])))
            names.append((f"column-phase:{plane}", len(measured.correctors[plane])))
        if "x" in measured.planes:
            names.append(("energy:x", len(measured.correctors["x"])))
        if measured.dispersion is not None:
            names.append(("rf", 1))
        names.append(("gradient", quadrupoles))
        of: dict[str, Indices] = {}
        begin = 0
        for name, count in names:
            of[name] = np.arange(begin, begin + count)
            begin += count
        return cls(begin, of)


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """σ_ij = s_i t_j of one block, and which elements count.

    Args:
        rows: s, shape (n,) [m/rad].
        columns: t, shape (m,) [1].
        kept: Elements that count, shape (n, m).
        outliers: Elements that were measured and do not, shape (n, m).
    """

    rows: Vector
    columns: Vector
    kept: Mask
    outliers: Mask

    @property
    def sigma(self) -> Matrix:
        """Shape (n, m) [m/rad]."""
        return np.outer(self.rows, self.columns)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The fitted response in the planes.

    Args:
        groups: Where the parameters stand.
        theta: Parameters, shape (k,).
        posterior: Their uncertainty, as the noise is.
        matrix: Normal matrix, shape (k, k).
        free: Parameters that were let free, shape (k,).
        spread: Healthy spread of every group.
        noise: Of every plane.
        steps: Gauss-Newton steps taken.
        converged: Whether the last step was small.
        model: Fitted response of every plane, shape (n, m) [m/rad].
        optics: Fitted.
        residual: Measured less model, of every plane [m/rad].
    """

    groups: Groups
    theta: Vector
    posterior: Posterior
    matrix: Matrix
    free: Mask
    spread: dict[str, float]
    noise: dict[Plane, Noise]
    steps: int
    converged: bool
    model: dict[Plane, Matrix]
    optics: dict[Plane, PlaneOptics]
    residual: dict[Plane, Matrix] = field(default_factory=lambda: {})

    def part(self, name: str) -> Vector:
        """Values of a group."""
        return self.theta[self.groups.of[name]]

    def sigma(self, name: str) -> Vector:
        """Standard deviations of a group, as the noise is."""
        return self.posterior.sigma[self.groups.of[name]]

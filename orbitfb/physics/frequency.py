"""The RF frequency as an actuator: what it does to the orbit, what correctors do to the energy.

At a fixed circumference a change Δf of the frequency changes the energy by δ = −Δf / (α_c f), and
the orbit by η δ. A horizontal kick θ where the dispersion is η lengthens the orbit by η θ, so that
at fixed frequency the correctors of a ring change its energy by

    δ = −Σ_j η_j θ_j / (α_c C).

Source: J. Safranek, Nucl. Instrum. Meth. A 388 (1997) 27, eq. 2. The beam is ultra-relativistic.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Mask, Vector
from orbitfb.physics.optics import rf_orbit
from orbitfb.physics.places import Planes, Ring, split

DAMPING = 1e-3
"""Damping of `undoing` in parts of the largest singular value."""


@dataclass(frozen=True, slots=True, eq=False)
class FrequencyModel:
    """What the frequency and the correctors do to orbit and energy.

    Args:
        response: Orbit per frequency, shape (n,) [m/Hz]; zeros in y.
        energy: Relative energy deviation per ampere of each corrector, shape (m,) [1/A]; zeros
            in y.
        per_hertz: Relative energy deviation per frequency [1/Hz].
    """

    response: Vector
    energy: Vector
    per_hertz: float


def frequency_response(ring: Ring, planes: Planes) -> Vector:
    """Orbit per frequency, the RF column of the response: −η / (α_c f) in x, 0 in y.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.

    Returns:
        Shape (n,) [m/Hz].
    """
    return np.concatenate(
        [
            rf_orbit(ring, "BPM", 1.0) if plane == "x" else np.zeros(len(ring.places("BPM", plane)))
            for plane in split(planes)
        ]
    )


def frequency_model(ring: Ring, planes: Planes) -> FrequencyModel:
    """Make the model of a ring.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.

    Raises:
        RingError: Plane x is not under feedback, there is no dispersion at the BPMs, or the
            dispersion has another sign than the momentum compaction.
    """
    if "x" not in planes:
        raise RingError(
            "the RF frequency moves the beam in plane x alone; add x to ring.planes, or set "
            "rf.enabled = false"
        )
    check_dispersion(ring)
    parameters = ring.parameters
    stretch = parameters.alpha_c * parameters.circumference
    bends = -ring.table.dispersion[ring.places("COR", "x")] * ring.calibration("x") / stretch
    rest = np.zeros(len(ring.places("COR", "y")))
    energy = np.concatenate([bends if plane == "x" else rest for plane in split(planes)])
    per_hertz = -1.0 / (parameters.alpha_c * ring.rf_frequency)
    return FrequencyModel(frequency_response(ring, planes), energy, per_hertz)


def check_dispersion(ring: Ring) -> None:
    """Refuse a dispersion of the wrong sign: the frequency would be driven the wrong way.

    The momentum compaction is the mean of η / ρ around the ring, and all bends bend one way. So
    the mean dispersion of a table has its sign.

    Args:
        ring: The ring.

    Raises:
        RingError: It has the other one, or there is no dispersion.
    """
    dispersion, alpha = ring.table.dispersion, ring.parameters.alpha_c
    mean = float(np.mean(dispersion))
    if not np.any(dispersion[ring.places("BPM", "x")]):
        raise RingError(
            "the places table has no dispersion (eta_x_m) at the BPMs, so that the RF frequency "
            "cannot be told from the orbit; fill the column in, or set rf.enabled = false"
        )
    if mean * alpha < 0:
        raise RingError(
            f"the mean dispersion of the places table is {mean:.3g} m, but alpha_c = {alpha:.3g}: "
            "they have the same sign in every ring; correct the sign of eta_x_m or of alpha_c, or "
            "set rf.enabled = false"
        )


def undoing(response: Vector, orbit: Vector, movable: Mask) -> Vector:
    """Find the change of setpoints that undoes an orbit, by damped least squares.

    Damping by a part of the largest singular value leaves weak modes alone: they would take large
    currents for little of the orbit. On the default ring 5 % of the dispersion orbit is left.

    Args:
        response: R, shape (n, m) [m/A].
        orbit: To undo, shape (n,) [m], or per anything.
        movable: Correctors that may move, shape (m,).

    Returns:
        Shape (m,) [A], or per the same; 0 where not movable.
    """
    own = response[:, movable]
    square = own.T @ own
    square.flat[:: len(square) + 1] += (DAMPING * np.linalg.norm(own, 2)) ** 2
    change = np.zeros(response.shape[1])
    change[movable] = -np.linalg.solve(square, own.T @ orbit)
    return change

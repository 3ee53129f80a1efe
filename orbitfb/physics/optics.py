"""Closed-orbit optics: everything follows from the Green's function between places.

Sources: E. D. Courant and H. S. Snyder, Ann. Phys. 3 (1958), eqs. 4.4 and 4.10 (closed orbit and
beta-beat); the dispersion term of a ring at fixed RF frequency: e.g. J. Safranek,
Nucl. Instrum. Meth. A 388 (1997), eq. 2. The beam is taken as ultra-relativistic.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.physics.places import Indices, Kind, Plane, Ring, plane_row

Matrix = NDArray[np.float64]
Places = Indices | Kind


def indices(ring: Ring, places: Places, plane: Plane) -> Indices:
    """Turn a kind of places, or indices into the table, into indices, shape (k,).

    Of BPMs and correctors those that are in the plane.
    """
    return ring.places(places, plane) if isinstance(places, str) else places


def green(ring: Ring, observers: Places, sources: Places, plane: Plane) -> Matrix:
    """Closed orbit at the observers per kick at the sources, at fixed RF frequency.

    G(i, j) = sqrt(β_i β_j) / (2 sin πν) · cos(|φ_i − φ_j| − πν) − η_i η_j / (α_c C),
    the last term horizontal only.

    Args:
        ring: The ring.
        observers: n indices into the table of places, or a kind of places.
        sources: m indices into the table of places, or a kind of places.
        plane: `x` or `y`.

    Returns:
        Shape (n, m) [m/rad].
    """
    rows, columns = indices(ring, observers, plane), indices(ring, sources, plane)
    row, half_turn = plane_row(plane), np.pi * ring.tune(plane)
    root_beta, phase = np.sqrt(ring.table.beta[row]), ring.table.phase[row]
    distance = np.abs(phase[rows, None] - phase[None, columns])
    amplitude = root_beta[rows, None] * root_beta[None, columns] / (2 * np.sin(half_turn))
    betatron = amplitude * np.cos(distance - half_turn)
    if plane == "y":
        return betatron
    dispersion = ring.table.dispersion
    stretch = ring.parameters.alpha_c * ring.parameters.circumference
    return betatron - np.outer(dispersion[rows], dispersion[columns]) / stretch


def green_with_gradient_errors(
    ring: Ring, observers: Places, sources: Places, plane: Plane, gradient_errors: Vector
) -> Matrix:
    """Green's function of the ring with gradient errors, exact for thin quadrupoles.

    An orbit x in a quadrupole whose integrated gradient is Δk too strong is kicked by −Δk x
    horizontally and +Δk y vertically, so G' = G_bc + G_bq K (1 − G_qq K)⁻¹ G_qc with
    K = diag(∓Δk).

    Args:
        ring: The ring.
        observers: n indices into the table of places, or a kind of places.
        sources: m indices into the table of places, or a kind of places.
        plane: `x` or `y`.
        gradient_errors: Δk1L of every quadrupole in ring order, shape (q,) [1/m].

    Returns:
        Shape (n, m) [m/rad].

    Raises:
        RingError: Not one finite value per quadrupole, or the errors leave no closed orbit.
    """
    quadrupoles = ring.places("QUAD")
    if gradient_errors.shape != quadrupoles.shape or not np.isfinite(gradient_errors).all():
        raise RingError(
            f"gradient errors of shape {gradient_errors.shape} for {len(quadrupoles)} quadrupoles; "
            "give one finite value [1/m] per quadrupole, in the order of the places table"
        )
    kick = -gradient_errors if plane == "x" else gradient_errors
    own = green(ring, quadrupoles, quadrupoles, plane)
    into, back = (
        green(ring, quadrupoles, sources, plane),
        green(ring, observers, quadrupoles, plane),
    )
    try:
        added = in_thin_lenses(back, kick, own, into)
    except np.linalg.LinAlgError as error:
        raise RingError(
            "the gradient errors put the ring on an integer resonance, where no closed orbit "
            "exists; make them smaller"
        ) from error
    return green(ring, observers, sources, plane) + added


def in_thin_lenses(back: Matrix, strength: Vector, own: Matrix, into: Matrix) -> Matrix:
    """Orbit that thin lenses make of the orbit in them and of what they add to it, (n, m).

    Args:
        back: Orbit per kick of every lens, shape (n, q).
        strength: Kick per orbit in every lens, shape (q,).
        own: Orbit in every lens per kick of every lens, shape (q, q).
        into: Orbit in every lens without any of them, shape (q, m).
    """
    return (back * strength) @ np.linalg.solve(np.eye(len(strength)) - own * strength, into)


def beta_beat(ring: Ring, observers: Places, plane: Plane, gradient_errors: Vector) -> Vector:
    """Relative change of beta at the observers, first order in the gradient errors.

    Δβ/β (i) = ∓ 1 / (2 sin 2πν) · Σ_j Δk_j β_j cos(2 |φ_i − φ_j| − 2πν); − in x, + in y.

    Args:
        ring: The ring.
        observers: n indices into the table of places, or a kind of places.
        plane: `x` or `y`.
        gradient_errors: Δk1L of every quadrupole in ring order, shape (q,) [1/m].

    Returns:
        Shape (n,), a ratio.
    """
    rows, quadrupoles = indices(ring, observers, plane), ring.places("QUAD")
    row, turn = plane_row(plane), 2 * np.pi * ring.tune(plane)
    phase = ring.table.phase[row]
    distance = np.abs(phase[rows, None] - phase[None, quadrupoles])
    pattern = np.cos(2 * distance - turn) @ (ring.table.beta[row, quadrupoles] * gradient_errors)
    sign = -1 if plane == "x" else 1
    return sign * pattern / (2 * np.sin(turn))


def energy_orbit(ring: Ring, observers: Places, deviation: float) -> Vector:
    """Horizontal orbit of a relative energy deviation: η δ, shape (n,) [m]."""
    return ring.table.dispersion[indices(ring, observers, "x")] * deviation


def angles_around(s: Vector, orbit: Matrix, circumference: float) -> Matrix:
    """Angle of an orbit from place to place, times the root of their distance.

    Its squares add up to ∮ x′² ds, twice the length that the orbit adds to the ring's.

    Args:
        s: Of the places around the ring, rising, shape (k,) [m].
        orbit: There, shape (k, ...) [m], of orbits or of the response.
        circumference: Of the ring [m].

    Returns:
        Shape (k, ...) [m^½].
    """
    distance = np.diff(s, append=s[0] + circumference)
    steps = np.roll(orbit, -1, axis=0) - orbit
    return steps / np.sqrt(distance).reshape(-1, *(1,) * (orbit.ndim - 1))


def rf_orbit(ring: Ring, observers: Places, frequency_change: float) -> Vector:
    """Horizontal orbit of a change of the RF frequency: −η Δf / (α_c f).

    Args:
        ring: The ring.
        observers: n indices into the table of places, or a kind of places.
        frequency_change: Δf [Hz].

    Returns:
        Shape (n,) [m].
    """
    deviation = -frequency_change / (ring.rf_frequency * ring.parameters.alpha_c)
    return energy_orbit(ring, observers, deviation)

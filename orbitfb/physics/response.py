"""Response matrices: orbit at the BPMs per ampere, per metre of quadrupole displacement."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.physics.optics import Matrix, beta_beat, green, green_with_gradient_errors
from orbitfb.physics.places import Plane, Planes, Ring, split


def response(ring: Ring, planes: Planes = "x", gradient_errors: Vector | None = None) -> Matrix:
    """Response matrix of the correctors.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`; both are block-diagonal (upright magnets do not couple them).
        gradient_errors: Δk1L of every quadrupole, shape (q,) [1/m]; none when None.

    Returns:
        Shape (n, m) [m/A], rows BPMs and columns correctors, x first and then y.
    """

    def block(plane: Plane) -> Matrix:
        if gradient_errors is None:
            per_kick = green(ring, "BPM", "COR", plane)
        else:
            per_kick = green_with_gradient_errors(ring, "BPM", "COR", plane, gradient_errors)
        return per_kick * ring.calibration(plane)

    return _block_diagonal([block(plane) for plane in split(planes)])


def quadrupole_displacement_response(ring: Ring, planes: Planes = "x") -> Matrix:
    """Orbit per displacement of every quadrupole.

    A quadrupole displaced by d kicks by +k1L d horizontally and −k1L d vertically.

    Args:
        ring: The ring.
        planes: `x`, `y` or `xy`.

    Returns:
        Shape (n, q) or, for both planes, (n, 2 q) with x displacements first [m/m].
    """
    blocks = [
        green(ring, "BPM", "QUAD", plane) * ring.strength("QUAD") * (1 if plane == "x" else -1)
        for plane in split(planes)
    ]
    return _block_diagonal(blocks)


def seeded_gradient_errors(ring: Ring, beta_beat_rms: float = 0.07, seed: int = 0) -> Vector:
    """Draw gradient errors that make a given horizontal beta-beat.

    Every quadrupole gets a normal error relative to its strength. The part that shifts a tune is
    taken out (first order, both planes): the tune correction of a running ring does the same. All
    are then scaled by one factor so that the first-order rms beta-beat in x over the BPMs is the
    one asked for; the beat in y is what these errors make of it.

    Args:
        ring: The ring.
        beta_beat_rms: Wanted rms of Δβ_x/β_x at the BPMs, a ratio.
        seed: Seed of the draw.

    Returns:
        Δk1L, shape (q,) [1/m].

    Raises:
        RingError: The ring has no quadrupoles to put errors on.
    """
    strength = ring.strength("QUAD")
    if not np.any(strength):
        raise RingError(
            "the places table has no quadrupole with a strength, so no beta-beat can be made; "
            "add the quadrupoles, or set the drift's beta_beat to 0"
        )
    relative = np.random.default_rng(seed).standard_normal(len(strength))
    tune_shift = (ring.table.beta[:, ring.places("QUAD")] * strength).T
    relative -= tune_shift @ np.linalg.lstsq(tune_shift, relative)[0]
    errors = relative * strength
    beat = beta_beat(ring, "BPM", "x", errors)
    return errors * beta_beat_rms / np.sqrt(np.mean(beat**2))


def _block_diagonal(blocks: Sequence[Matrix]) -> Matrix:
    if len(blocks) == 1:
        return blocks[0]
    height = sum(block.shape[0] for block in blocks)
    width = sum(block.shape[1] for block in blocks)
    whole = np.zeros((height, width))
    row = column = 0
    for block in blocks:
        whole[row : row + block.shape[0], column : column + block.shape[1]] = block
        row, column = row + block.shape[0], column + block.shape[1]
    return whole

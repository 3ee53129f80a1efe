"""Shifts of the tunes, as all quadrupoles together make them."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.optics.gradients import response_with
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Layout

_WEAKEST = 0.01
"""Share of the strongest mode of the response from which a standing orbit is told by currents."""


def tune_gradients(layout: Layout, dnu_x: float, dnu_y: float) -> Vector:
    """Gradient errors that shift the tunes, the smallest relative to the strengths.

    4π Δν_x = Σ β_x Δk, 4π Δν_y = −Σ β_y Δk (E. D. Courant and H. S. Snyder, Ann. Phys. 3 (1958)
    eq. 4.5). Which quadrupoles share in it hardly matters: two families give the same change of R
    (cosine 0.99998 on the default ring). Scaling all phases by (ν + Δν) / ν is nearly the same
    in x but 13 % off in y, so it is not done.

    Args:
        layout: Devices and ring.
        dnu_x: Shift of the horizontal tune.
        dnu_y: Shift of the vertical tune.

    Returns:
        Δk1L, shape (q,) [1/m].
    """
    ring = layout.known_ring
    strength = np.nan_to_num(ring.strength("QUAD"))
    beta = ring.table.beta[:, ring.places("QUAD")]
    shift = np.stack([beta[0] * strength, -beta[1] * strength]) / (4 * np.pi)
    relative = np.asarray(np.linalg.pinv(shift) @ np.array([dnu_x, dnu_y]), dtype=np.float64)
    return strength * relative


def tune_change(layout: Layout, dnu_x: float, dnu_y: float) -> Matrix:
    """Change of the response by shifted tunes, shape (n, m) [m/A]."""
    if dnu_x == 0.0 and dnu_y == 0.0:
        return np.zeros_like(layout.response)
    nominal = response_with(layout, np.zeros(len(layout.known_ring.places("QUAD"))))
    return response_with(layout, tune_gradients(layout, dnu_x, dnu_y)) - nominal


def steering(layout: Layout, currents: Matrix, orbit: Matrix) -> Matrix:
    """Currents that would make the whole orbit, not only how it changes, shape (N, m) [A].

    Gradients kick by the orbit in them, whoever makes it. The correctors hold what misaligned
    magnets do to it, so their currents alone tell a standing orbit that is not there.

    Args:
        layout: Devices and model.
        currents: That act on the beam, shape (N, m) [A].
        orbit: At the BPMs, shape (N, n) [m].
    """
    besides = np.mean(orbit - currents @ layout.response.T, axis=0)
    return currents + np.linalg.lstsq(layout.response, besides, rcond=_WEAKEST)[0]


class ChangedTunes(Effect):
    """A response that changes by a matrix, constant or in proportion to time.

    Args:
        change: Of the response (per second if it grows), shape (n, m) [m/A].
        period: From tick to tick [s] if it grows; 0 if it does not.
    """

    def __init__(self, change: Matrix, period: float = 0.0) -> None:
        self._change, self._period = change, period

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Add the change."""
        scale = self._period * tick if self._period else 1.0
        return orbit + scale * (self._change @ currents)

"""Between metres and amperes and the numbers of order 1 that agents learn on.

Observations and actions may stand for devices, or for the singular modes of the known R. Along the
modes the law to be found is close to a diagonal one, which costs an agent far fewer steps.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector

Coordinates = Literal["modes", "devices"]
Numbers = NDArray[np.float32]

CLIP = 50.0
"""Largest observation, either sign [1]."""

REACH = 3.0
"""Orbit that an action of 1 takes away along its mode, in units of the scale [1]."""

_SMALLEST = 0.01
"""Singular values below this part of the largest count as that: agents need not reach further."""


@dataclass(frozen=True, slots=True, eq=False)
class Scaling:
    """How orbits become observations, and actions changes of the setpoints.

    Args:
        response: The known R, shape (n, m) [m/A].
        coordinates: `modes` or `devices`.
        scale: Orbit that counts as 1, rms [m].
        modes: The strongest modes that are seen and moved; None: all of them.
        view: What an orbit [m] is multiplied with, shape (k, n) [1/m].
        move: What an action is multiplied with, shape (m, j) [A].
    """

    response: Vector
    coordinates: Coordinates
    scale: float
    modes: int | None
    view: Vector
    move: Vector

    @classmethod
    def of(
        cls, response: Vector, coordinates: Coordinates, scale: float, modes: int | None = None
    ) -> "Scaling":
        """Make it for a response.

        Args:
            response: The known R, shape (n, m) [m/A].
            coordinates: `modes` or `devices`.
            scale: Orbit that counts as 1, rms [m].
            modes: The strongest modes that are seen and moved; None: all of them.

        Raises:
            ConfigError: There are no such coordinates or modes, or the scale is not above 0.
        """
        if not (np.isfinite(scale) and scale > 0):
            raise ConfigError(f"orbit_scale is {scale}; give an orbit above 0 m")
        n, m = response.shape
        if coordinates == "devices":
            seen = float(np.sqrt(np.mean(response**2)))
            if modes is not None:
                raise ConfigError("modes are chosen, but coordinates are devices; leave modes out")
            move = np.eye(m) * scale / seen
            return cls(response, coordinates, scale, None, np.eye(n) / scale, move)
        if coordinates != "modes":
            raise ConfigError(f"coordinates {coordinates!r}: choose modes or devices")
        if modes is not None and not 1 <= modes <= min(n, m):
            raise ConfigError(f"modes is {modes}; give 1 to {min(n, m)}, or leave it out for all")
        u, sigma, vt = np.linalg.svd(response, full_matrices=False)
        reachable = np.maximum(sigma, _SMALLEST * sigma[0])
        view, move = u.T / scale, vt.T * (REACH * scale / reachable)
        return cls(response, coordinates, scale, modes, view[:modes], move[:, :modes])

    def see(self, orbit: Vector) -> Numbers:
        """Turn an orbit error (n,) [m] into an observation (k,) [1]."""
        return np.clip(self.view @ orbit, -CLIP, CLIP).astype(np.float32)

    def change(self, action: NDArray[np.floating]) -> Vector:
        """Turn an action (j,) [1] into a change of the setpoints (m,) [A]."""
        return self.move @ np.clip(action.astype(np.float64), -1.0, 1.0)

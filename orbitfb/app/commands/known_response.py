"""The response of the ring as it is known to a running service."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.measure.response_file import MeasuredResponse


@dataclass(slots=True)
class KnownResponse:
    """The response that was measured last; any thread may read or replace it.

    Args:
        matrix: Shape (n, m) [m/A], zero where masked; None: none was measured, only the optics say
            what it is.
    """

    matrix: Vector | None = None

    def take(
        self, measured: MeasuredResponse, nominal: Vector, counting: Mask, moving: Mask
    ) -> None:
        """Take a measurement, with the optics where it has none.

        Args:
            measured: The measurement.
            nominal: By the optics, shape (n, m) [m/A].
            counting: BPMs that are not masked, shape (n,).
            moving: Correctors that are not masked, shape (m,).
        """
        own = measured.table.response
        known = np.where(np.isfinite(own), own, nominal)
        self.matrix = np.where(np.outer(counting, moving), known, 0.0)

"""A simulated ring that answers its correctors as a measured one did."""

from pathlib import Path

import numpy as np

from orbitfb.effects.element_kinds import ChangedElements
from orbitfb.measure.response_file import read_response
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.response import response


class MeasuredRing(ChangedElements):
    """The response is a measured one; gains of BPMs and correctors that it has are in it.

    Args:
        path: File of the measured response.
        ring: The ring.
        planes: `x`, `y` or `xy`.

    Raises:
        RingError: The file is missing, damaged, or of another ring.
    """

    def __init__(self, path: Path, ring: Ring, planes: Planes) -> None:
        table = read_response(path, ring.channels(planes)).table
        change = table.response - response(ring, planes)
        super().__init__(np.where(np.isfinite(change), change, 0.0))

"""What a measured response means for the loop, plane by plane."""

import numpy as np

from orbitfb.loco.measured import Measured
from orbitfb.loco.schema import Growth
from orbitfb.measure.growth import growth_of_optics, told
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Ring, plane_row


def growths(ring: Ring, measured: Measured, nominal: dict[Plane, Matrix]) -> tuple[Growth, ...]:
    """Close the default SVD of the table on the measured response, plane by plane.

    Args:
        ring: The ring.
        measured: As it was given.
        nominal: Response of the table, by plane [m/rad].
    """
    found: list[Growth] = []
    for plane in measured.planes:
        per_ampere = ring.table.calibration[plane_row(plane), measured.correctors[plane]]
        per_ampere = np.where(np.isfinite(per_ampere), per_ampere, 1.0)
        data = measured.response[plane, plane] * per_ampere
        growth = growth_of_optics(data, nominal[plane] * per_ampere)
        if growth is not None:
            found.append(
                Growth(planes=plane, per_tick=growth, text=f"plane {plane}: {told(growth)}")
            )
    return tuple(found)

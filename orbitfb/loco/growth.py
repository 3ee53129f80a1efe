"""What a measured response means for the loop: growth per tick of the law of the table on it."""

import numpy as np

from orbitfb.loco.measured import Measured
from orbitfb.loco.schema import Growth
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Ring, plane_row
from orbitfb.policies.stability import HIGHEST, growth_on
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def growths(
    ring: Ring, measured: Measured, nominal: dict[Plane, Matrix], settings: SvdSettings
) -> tuple[Growth, ...]:
    """Close the SVD of the table on the measured response, plane by plane.

    BPMs and correctors that were not measured whole are taken out of both.

    Args:
        ring: The ring.
        measured: As it was given.
        nominal: Response of the table, by plane [m/rad].
        settings: Of the law.
    """
    found: list[Growth] = []
    for plane in measured.planes:
        data = measured.response[plane, plane]
        there = np.isfinite(data)
        columns = there.any(axis=0)
        rows = there[:, columns].all(axis=1)
        if not rows.any():
            continue
        per_ampere = ring.table.calibration[plane_row(plane), measured.correctors[plane]][columns]
        per_ampere = np.where(np.isfinite(per_ampere), per_ampere, 1.0)
        believed = nominal[plane][np.ix_(rows, columns)] * per_ampere
        real = data[np.ix_(rows, columns)] * per_ampere
        growth = growth_on(SvdPolicy(believed, settings), real)
        found.append(Growth(planes=plane, per_tick=growth, text=told(plane, growth)))
    return tuple(found)


def told(planes: str, growth: float) -> str:
    """Say what a growth means."""
    if growth > HIGHEST:
        return (
            f"plane {planes}: an SVD loop on the table's response would lose the beam: on the "
            f"measured one the orbit grows by {growth:.4g} per tick; give the loop the measured "
            "or the fitted response (ring.response)"
        )
    return (
        f"plane {planes}: an SVD loop on the table's response holds on the measured one (growth "
        f"{growth:.5g} per tick)"
    )

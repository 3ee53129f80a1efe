"""What a measured response means for the loop, plane by plane."""

import numpy as np

from orbitfb.core.signals import Channels
from orbitfb.loco.measured import Measured
from orbitfb.loco.schema import Growth
from orbitfb.measure.growth import Loop, growth_by_plane, growth_of_optics, told
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane, Planes, Ring, plane_row
from orbitfb.physics.response import response


def growths(
    ring: Ring,
    measured: Measured,
    nominal: dict[Plane, Matrix],
    loop: Loop | None = None,
    planes: Planes = "xy",
) -> tuple[Growth, ...]:
    """Close a loop on the measured response, plane by plane.

    Args:
        ring: The ring.
        measured: As it was given.
        nominal: Response of the table, by plane [m/rad].
        loop: The loop; None: the default SVD of the table, of the devices that were measured.
        planes: Of the loop.
    """
    of_loop: dict[str, float] = {}
    if loop is not None:
        optics, channels = response(ring, planes), ring.channels(planes)
        whole = _in_order_of(ring, measured, channels)
        of_loop = growth_by_plane(whole, optics, channels, loop)
    found: list[Growth] = []
    for plane in measured.planes:
        per_ampere = _per_ampere(ring, measured, plane)
        data = measured.response[plane, plane] * per_ampere
        growth, closed = of_loop.get(plane), loop
        if growth is None:  # the loop is of the other plane
            growth, closed = growth_of_optics(data, nominal[plane] * per_ampere), None
        if growth is not None:
            text = f"plane {plane}: {told(growth, closed)}"
            found.append(Growth(planes=plane, per_tick=growth, text=text))
    return tuple(found)


def _per_ampere(ring: Ring, measured: Measured, plane: Plane) -> np.ndarray:
    per_ampere = ring.table.calibration[plane_row(plane), measured.correctors[plane]]
    return np.where(np.isfinite(per_ampere), per_ampere, 1.0)


def _in_order_of(ring: Ring, measured: Measured, channels: Channels) -> Matrix:
    """Write the own blocks in the order of a loop, shape (n, m) [m/A]; NaN where not measured."""
    whole = np.full((len(channels.bpms), len(channels.correctors)), np.nan)
    for plane, rows in channels.bpm_parts.items():
        if plane not in measured.planes:
            continue
        some = np.isin(measured.bpms[plane], ring.places("BPM", plane))
        own = np.isin(measured.correctors[plane], ring.places("COR", plane))
        at = rows.start + np.searchsorted(ring.places("BPM", plane), measured.bpms[plane][some])
        by = channels.corrector_parts[plane].start + np.searchsorted(
            ring.places("COR", plane), measured.correctors[plane][own]
        )
        data = measured.response[plane, plane] * _per_ampere(ring, measured, plane)
        whole[np.ix_(at, by)] = data[np.ix_(some, own)]
    return whole

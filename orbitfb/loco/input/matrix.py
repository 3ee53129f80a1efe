"""A matrix of a file, as it stands there."""

from dataclasses import dataclass

from orbitfb.core.signals import Vector
from orbitfb.loco.measured import Pair
from orbitfb.physics.optics import Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Raw:
    """A matrix of a file.

    Args:
        where: In the file, for messages.
        values: Shape (n, m), in the unit of the file.
        unit: As the file says; empty: it does not.
        rows: Names of the BPMs; empty: none.
        columns: Names of the correctors; empty: none.
        sigma: Standard deviations, the same unit; None: not known.
        pair: Planes of rows and columns, where the file says.
        planes: Planes that are stacked in it, where the file says.
        dispersion: Measured horizontal dispersion of the rows [m], or the change of their orbit by
            a relative change of the RF frequency of 1 [m]; None: not in the file.
        by_frequency: Whether it is the latter.
    """

    where: str
    values: Matrix
    unit: str = ""
    rows: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    sigma: Matrix | None = None
    pair: Pair | None = None
    planes: str | None = None
    dispersion: Vector | None = None
    by_frequency: bool = False

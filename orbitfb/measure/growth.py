"""What a measured matrix means for a loop on the optics: growth of the orbit per tick."""

import numpy as np

from orbitfb.core.signals import Channels, Vector
from orbitfb.policies.stability import HIGHEST, growth_on
from orbitfb.policies.svd import SvdPolicy, SvdSettings


def growth_of_optics(measured: Vector, nominal: Vector) -> float | None:
    """Close the default SVD of the optics on a measured matrix.

    Rows and columns that were not measured whole are taken out of both.

    Args:
        measured: Shape (n, m) [m/A]; NaN where not.
        nominal: By the optics, shape (n, m) [m/A].

    Returns:
        Growth per tick [1]; None where nothing was measured.
    """
    there = np.isfinite(measured)
    columns = there.any(axis=0)
    rows = there[:, columns].all(axis=1) & columns.any()
    if not rows.any():
        return None
    some = np.ix_(rows, columns)
    return growth_on(SvdPolicy(nominal[some], SvdSettings()), measured[some])


def growth_told(measured: Vector, nominal: Vector, channels: Channels) -> dict[str, str]:
    """Say it plane by plane, for people."""
    found: dict[str, str] = {}
    columns = channels.corrector_parts
    for plane, rows in channels.bpm_parts.items():
        block = rows, columns[plane]
        growth = growth_of_optics(measured[block], nominal[block])
        if growth is not None:
            found[plane] = told(growth)
    return found


def told(growth: float) -> str:
    """Say what a growth means."""
    if growth > HIGHEST:
        return (
            f"an SVD loop on the optics would lose the beam: on the measured response the orbit "
            f"grows by {growth:.4g} per tick; give the loop this response (ring.response)"
        )
    return f"an SVD loop on the optics holds on the measured response ({growth:.5g} per tick)"

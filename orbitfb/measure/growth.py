"""What a measured matrix means for a loop that was made for another: growth per tick."""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Channels, Vector
from orbitfb.policies.stability import HIGHEST, growth_on
from orbitfb.policies.svd import SvdPolicy, SvdSettings


@dataclass(frozen=True, slots=True)
class Loop:
    """The loop that is closed on a measured matrix.

    Args:
        policy: Of all planes.
        name: For messages: policy svd-0123 (in force).
    """

    policy: Policy
    name: str


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


def growth_by_plane(
    measured: Vector, nominal: Vector, channels: Channels, loop: Loop | None
) -> dict[str, float]:
    """Close a loop on a measured matrix, plane by plane.

    Args:
        measured: Shape (n, m) [m/A]; NaN where not. A policy finds the optics there.
        nominal: By the optics, shape (n, m) [m/A].
        channels: Of rows and columns.
        loop: The loop; None: the default SVD of the optics, of what was measured.

    Returns:
        Growth per tick of every plane in which something was measured [1].
    """
    found: dict[str, float] = {}
    columns = channels.corrector_parts
    for plane, rows in channels.bpm_parts.items():
        own, optics = measured[rows, columns[plane]], nominal[rows, columns[plane]]
        if not np.isfinite(own).any():
            continue
        if loop is not None:
            whole = np.where(np.isfinite(own), own, optics)
            found[plane] = growth_on(loop.policy, whole, (rows, columns[plane]))
        elif (growth := growth_of_optics(own, optics)) is not None:
            found[plane] = growth
    return found


def growth_told(
    measured: Vector, nominal: Vector, channels: Channels, loop: Loop | None = None
) -> dict[str, str]:
    """Say it plane by plane, for people."""
    growths = growth_by_plane(measured, nominal, channels, loop)
    return {plane: told(growth, loop) for plane, growth in growths.items()}


def told(growth: float, loop: Loop | None = None) -> str:
    """Say what a growth means."""
    name = "an SVD loop on the optics" if loop is None else loop.name
    if growth > HIGHEST:
        return (
            f"{name} would lose the beam: on the measured response the orbit grows by "
            f"{growth:.4g} per tick; give the loop this response (ring.response)"
        )
    return f"{name} holds on the measured response ({growth:.5g} per tick)"

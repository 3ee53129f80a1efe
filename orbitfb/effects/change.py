"""What effects of given places add to the orbit of a whole record."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kinds import Values
from orbitfb.effects.orbit_kinds import SourceKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record


def source_change(
    kind: SourceKind,
    values: Values,
    record: Record,
    currents: Matrix,
    orbit: Matrix,
    weights: Vector,
) -> Matrix:
    """Tell what sources add to the orbit: patterns times drivers, plane by plane.

    Args:
        kind: The effect.
        values: All parameters.
        record: As for `SourceKind.drivers`.
        currents: As for `SourceKind.drivers`.
        orbit: As for `SourceKind.drivers`.
        weights: How much of the effect each place has (1 or 0 as a rule), shape (P,).

    Returns:
        Shape (N, n) [m].
    """
    chosen = np.flatnonzero(weights)
    patterns = kind.patterns(record.layout)[:, chosen] * weights[chosen]
    courses = kind.drivers_at(chosen, values, record, currents, orbit)
    if courses.shape[-1] == 1:
        patterns = np.sum(patterns, axis=1, keepdims=True)
    if courses.ndim == 2:
        return courses @ patterns.T
    added = np.zeros_like(orbit)
    for plane, course in zip(("x", "y"), courses, strict=True):
        rows = record.layout.bpms.in_plane(plane)
        added[:, rows] = course @ patterns[rows].T
    return added

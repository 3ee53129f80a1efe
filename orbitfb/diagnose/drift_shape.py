"""How the orbit drifts where nobody knows how the magnets move: its shape is that of the record.

The modes of a floor are those in which a known ring drifts. Without its quadrupoles they are a
guess, in which the motion of one mode goes along with that of another; what is white in the right
modes then looks as if something were left to explain.
"""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench

_DRIFTING = 0.3
"""Kalman gain of a mode from which its innovations are drift rather than reading noise."""
_ROWS = 15
"""Rows for every mode whose motion is compared with the others'."""
_SURE = 5.0
"""Standard deviations by which modes must go along with each other beyond chance."""


def with_own_shape(bench: Bench) -> Bench:
    """Judge a record of a ring that is not known in the modes in which it drifts.

    Args:
        bench: The record under all causes.

    Returns:
        The same where the ring or the floor is known, or where the modes go each its own way.
    """
    layout, floor = bench.record.layout, bench.floor
    if layout.ring is not None or bench.told_floor:
        return bench
    white = bench.white[~bench.record.starts]
    count = min(int(np.sum(floor.gains > _DRIFTING)), len(white) // _ROWS)
    strong = np.argsort(floor.gains)[::-1][:count]
    together = white[:, strong].T @ white[:, strong] / max(len(white), 1)
    pairs = together[np.triu_indices(count, 1)]
    beyond = len(white) * float(np.sum(pairs**2)) - len(pairs)
    if beyond <= _SURE * np.sqrt(2.0 * len(pairs)):
        return bench
    size = np.sqrt(floor.innovation_variance[strong])
    turned = np.linalg.eigh(together * np.outer(size, size))[1][:, ::-1]
    axes = floor.modes.axes.copy()
    axes[:, strong] = axes[:, strong] @ turned
    modes = replace(floor.modes, axes=axes)
    return Bench(bench.record, bench.causes, None, modes, bench.scale)

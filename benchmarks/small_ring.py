"""A ring of a quarter of the default one's devices, for tests that simulate many records."""

from dataclasses import replace

import numpy as np

from orbitfb.physics.places import Ring

EVERY = 4
"""Every which BPM, corrector, quadrupole and sextupole stays."""


def small_ring(every: int = EVERY) -> Ring:
    """The default ring with the optics that it has, read and steered at fewer places."""
    ring = Ring.load()
    table = ring.table
    kept: list[int] = []
    seen: dict[str, int] = {}
    for index, kind in enumerate(table.kind):
        if seen.get(kind, 0) % every == 0:
            kept.append(index)
        seen[kind] = seen.get(kind, 0) + 1
    rows = np.array(kept, dtype=np.intp)
    x, y = table.pv
    read_x, read_y = table.readback
    fewer = replace(
        table,
        name=tuple(table.name[i] for i in kept),
        kind=tuple(table.kind[i] for i in kept),
        s=table.s[rows],
        beta=table.beta[:, rows],
        phase=table.phase[:, rows],
        dispersion=table.dispersion[rows],
        strength=table.strength[rows],
        calibration=table.calibration[:, rows],
        pv=(tuple(x[i] for i in kept), tuple(y[i] for i in kept)),
        readback=(tuple(read_x[i] for i in kept), tuple(read_y[i] for i in kept)),
    )
    return Ring(fewer, ring.parameters)

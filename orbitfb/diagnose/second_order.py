"""Take healthy errors around those that a record shows, where it sees that they do not add up."""

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bent import straightened
from orbitfb.records.layout import HealthyErrors

_HEALTHY = 1.0
"""Mean square of the sizes of errors, in units of their scatter, beyond which they are none: they
have swallowed a cause, and are far from those beside it."""
_UNSEEN = 1.0
"""Squared change of the innovations that no record shows."""


def second_order(bench: Bench) -> Bench:
    """Judge a record around its own healthy errors.

    Args:
        bench: The record with errors that are taken to add up.

    Returns:
        That of the record whose errors do; the same where nothing is seen of it, or where the
        record is no likelier then.
    """
    layout, sizes = bench.record.layout, bench.sizes
    errors = shown(bench)
    if errors is None or layout.healthy is not None or np.mean(sizes**2) > _HEALTHY:
        return bench
    record = straightened(bench.record, errors, bench.currents)
    if bench.energy(bench.record.readings - record.readings) < _UNSEEN:
        return bench
    floor = bench.floor if bench.told_floor else None
    other = Bench(record, bench.causes, floor, bench.floor.modes, bench.scale)
    return other if _evidence(other) > _evidence(bench) else bench


def shown(bench: Bench) -> HealthyErrors | None:
    """Healthy errors that a record shows; None where the ring or its magnets are not known."""
    layout = bench.record.layout
    if layout.ring is None or not len(layout.ring.places("QUAD")) or not len(bench.sizes):
        return None
    background = bench.background
    gains = background.errors("correctors", bench.sizes)
    return HealthyErrors(gains, {p: background.errors(p, bench.sizes) for p in layout.planes})


def _evidence(bench: Bench) -> float:
    return bench.full_log_likelihood + bench.background.log_volume

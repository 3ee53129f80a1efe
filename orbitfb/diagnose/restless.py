"""Rings whose healthy gradients scatter more than usual: the rival of any single gradient.

How much gradients beat is the same for most rings, how large they are for that is not: errors that
leave the tunes right, or that beat in the other plane, may be several times as large. What a record
shows of them is explained by no single one, but in part by the largest. So an effect of the optics
at some magnets has to explain more than gradients everywhere that are somewhat larger would.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.entry import Entry, profiled, refitted
from orbitfb.records.record import Record

_SCATTERS = (1.5, 2.0, 3.0)
"""Scatters that are tried, over the usual one."""
_USUAL = 0.5
"""How far their logarithm is from 0 in the rings there are, rms: a factor of 1.6 [1]."""


def restless(bench: Bench, best: Entry | None) -> Record | None:
    """Give the record of a more restless ring, if that explains it better than a cause does.

    A cause may be there in such a ring too. So what is compared is the evidence of all that each
    ring would tell: gradients that are larger, with the cause where it is still worth its price
    beside them, against the cause in the usual ring, which pays for its values and the choice of
    its place as well. What a single error gains is shared out by gradients everywhere, two thirds
    of it, and the rest is not worth the price twice: they are the better explanation only where
    many of them are larger.

    Args:
        bench: The record without the cause.
        best: What explains it best; only effects at quadrupoles and sextupoles have this rival.
    """
    layout = bench.record.layout
    if best is None or best.kind.target not in ("quadrupole", "sextupole"):
        return None
    if layout.ring is None or layout.restless != 1.0:
        return None
    evidence, found = max(_evidences(bench, best), key=lambda one: one[0])
    return found if evidence > best.weight else None


def _evidences(bench: Bench, best: Entry) -> Iterator[tuple[float, Record]]:
    """Evidence for more restless rings beyond the usual one [nats], and the record in each."""
    record, usual = bench.record, _evidence(bench)
    floor = bench.floor if bench.told_floor else None
    for scatter in _SCATTERS:
        there = replace(record, layout=replace(record.layout, restless=scatter))
        wider = Bench(there, bench.causes, floor, bench.floor.modes)
        price = 0.5 * (np.log(scatter) / _USUAL) ** 2
        beside = max(_beside(wider, best), 0.0)
        yield _evidence(wider) - usual - float(price) + beside, there


def _beside(wider: Bench, best: Entry) -> float:
    """What a cause is still worth where gradients are larger [nats]."""
    if best.fit is None:
        return 0.0
    there = refitted(wider, best)
    return profiled(wider, there, there.weight)[0].weight


def _evidence(bench: Bench) -> float:
    return bench.full_log_likelihood + bench.background.log_volume

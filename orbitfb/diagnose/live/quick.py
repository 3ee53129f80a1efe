"""A workspace estimated in a second: noise and drift once, from few shapes and few bands."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.likelihood.ground import ground_shapes
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.kinds import EffectKind
from orbitfb.estimation.evidence import NormalTerms
from orbitfb.estimation.transform import StepTransform
from orbitfb.records.record import Record

_BANDS = 8
"""Bands of λ: half of those of a diagnosis, at half the time. The least likely mode of the noise is
then right to a tenth within a band."""

_SHARES = (1.0, 10.0)
"""Sizes of a late response that are tested, over the healthy scatter: 1 % and 10 % of a step."""


def quick_workspace(record: Record, kinds: Sequence[EffectKind]) -> Workspace:
    """Estimate noise and drift of a record as a diagnosis does at first.

    Of the shapes of ground motion only the families are fitted, not single girders. The free part
    of the drift takes what these families cannot describe.

    Args:
        record: The record.
        kinds: Effects that are tested.

    Raises:
        EstimationError: The record is too short, or does not move.
    """
    transform = StepTransform.of(record.starts, _BANDS)
    ground = ground_shapes(record.layout)
    broad = replace(ground, single=np.zeros((record.readings.shape[1], 0)))
    return Workspace.begun(record, kinds, transform, broad).with_floor()


def memory(space: Workspace) -> float:
    """Compute the evidence that all devices respond a little late, each in its own way [nats].

    Args:
        space: A workspace whose healthy errors include courses that are some rows late.
    """
    terms = space.saturable().errors
    base = terms.evidence()
    best = base
    for share in _SHARES:
        variance = terms.variance.copy()
        for block in space.blocks:
            if block.delayed.stop > block.delayed.start:
                copies = (block.delayed.stop - block.delayed.start) // len(block.limit)
                variance[block.delayed] = np.tile((share * block.limit) ** 2, copies)
        best = max(best, NormalTerms(terms.pull, terms.information, variance).evidence())
    return best - base

"""What errors add together, beyond the sum of what each adds alone."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.likelihood.errors import ErrorBlock
from orbitfb.diagnose.likelihood.terms import Terms
from orbitfb.effects.laws import Signals
from orbitfb.estimation.transform import Matrix, StepTransform
from orbitfb.records.layout import Layout


def added_together(
    blocks: Sequence[ErrorBlock],
    sizes: Vector,
    driving: Mask,
    terms: Terms,
    signals: Signals,
    transform: StepTransform,
) -> Matrix:
    """Spectrum of what errors add together, beyond the sum of each alone, shape (T, n) [m].

    The columns are those of each alone. Gradients act on the orbit that others have made, which is
    of the order of the beta-beat times what they do, and in that of correctors with their errors.

    Args:
        blocks: Of all columns.
        sizes: Of the columns, shape (k,).
        driving: Columns whose errors are in the currents already, shape (k,).
        terms: The columns.
        signals: With the currents that act on the beam.
        transform: Of the record.
    """
    layout = signals.record.layout
    known = _changed_response(blocks, sizes, layout)
    if known is None:
        return np.zeros((len(transform), len(layout.response)))
    change, its = known
    acting = transform.quick_spectrum(signals.currents)
    fresh = np.where(driving, 0.0, sizes).astype(np.float32)
    for block in blocks:
        if not block.accepted and block.law.patterns[0] is layout.response:
            acting = acting + terms.spectrum[:, block.columns] * fresh[block.columns]
    whole = acting @ change.T.astype(np.float32)
    return whole.astype(np.float64) - terms.contribution(its)


def _changed_response(
    blocks: Sequence[ErrorBlock], sizes: Vector, layout: Layout
) -> tuple[Matrix, Vector] | None:
    """Change of the response by errors that act on one another.

    Args:
        blocks: Of all columns.
        sizes: Of the columns, shape (k,).
        layout: Of the record.

    Returns:
        What they do to the response together, shape (n, m) [m/A], and the sizes of these errors,
        shape (k,), the others zero; None: no errors do.
    """
    found, its = np.zeros_like(layout.response), np.zeros_like(sizes)
    healthy = [block for block in blocks if not block.accepted]
    for kind in dict.fromkeys(block.kind for block in healthy):
        own = [block for block in healthy if block.kind is kind]
        by_block = [np.zeros(one.shape[1]) for one in own[0].law.patterns]
        for block in own:
            by_block[block.pattern] = sizes[block.columns]
        change = kind.together(layout, by_block)
        if change is not None:
            found += change
            for block in own:
                its[block.columns] = sizes[block.columns]
    return (found, its) if np.any(its) else None

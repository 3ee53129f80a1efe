"""Take the strikes of an effect that nobody can foresee out of a record, tick by tick."""

from dataclasses import replace

import numpy as np

from orbitfb.core.signals import Mask
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.strike_scan import latent_odds
from orbitfb.effects.random_kinds import LatentKind
from orbitfb.records.record import Record

_LIKELY = 0.5
_MOST = 0.3
"""Share of rows beyond which cutting them out would leave no record."""


def without_strikes(bench: Bench, kind: LatentKind, cause: Cause) -> Record:
    """Give struck rows the setpoints of the row before, or struck readings the prediction.

    Args:
        bench: The record under the causes so far.
        kind: What strikes.
        cause: Where, with which parameters.

    Returns:
        The record without the strikes; as it was when they are too many, or never certain.
    """
    record = bench.record
    struck = _struck(bench, kind, cause)
    if struck.mean() > _MOST or not struck.any():
        return record
    if kind.per_bpm:
        readings = np.where(struck, bench.orbit, record.readings)
        return replace(record, readings=readings, filled=record.filled | struck)
    # Setpoints that were not in force: those of the row before were.
    setpoints = record.setpoints.copy()
    columns = list(cause.places) or slice(None)
    for row in np.flatnonzero(struck[:, 0] & ~record.starts):
        setpoints[row, columns] = setpoints[row - 1, columns]
    return replace(record, setpoints=setpoints)


def struck_rows(bench: Bench, kind: LatentKind, cause: Cause) -> Mask:
    """Tell which rows were struck more likely than not, shape (N,).

    Args:
        bench: The record under the causes so far.
        kind: What strikes.
        cause: Where, with which parameters.
    """
    return np.asarray(_struck(bench, kind, cause).any(axis=1), dtype=bool)


def _struck(bench: Bench, kind: LatentKind, cause: Cause) -> Mask:
    struck = latent_odds(bench, kind, cause.values, cause.places) > _LIKELY
    if kind.per_bpm:
        struck[:, [i for i in range(struck.shape[1]) if i not in cause.places]] = False
    return struck

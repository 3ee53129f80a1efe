"""Slow channels of a record from elsewhere: stored current, RF frequency, gaps, and what else."""

from collections.abc import Mapping

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.records.finding import Finding
from orbitfb.records.gaps import is_gap
from orbitfb.records.reading.metadata import Meta
from orbitfb.records.reading.raw import NUMBERS, Raw

_NAMES = {"current": "current", "rf": "rf_frequency"}


def slow_channels(
    raw: Raw, meta: Meta, scaled: Mapping[str, Vector], rows: int
) -> tuple[dict[str, Vector], list[Finding]]:
    """Take current, RF frequency, and every other column with one finite number per row.

    Gaps are lengths; of the others nobody asks the unit.

    Args:
        raw: The arrays.
        meta: What the record says of itself.
        scaled: The arrays that have a name of their own, SI.
        rows: Of the record.

    Returns:
        The channels, each (rows,) or longer; which gaps are left out, and in which unit those are
        taken of which nobody says it.

    Raises:
        RecordError: The unit of a gap is no length.
    """
    channels: dict[str, Vector] = {}
    found: list[Finding] = []
    for name, values in raw.numbers.items():
        if name in NUMBERS:
            continue
        if len(values) >= rows and np.isfinite(values).all():
            factor = meta.factor(raw, name) if is_gap(name) else 1.0
            channels[name] = values[:rows] * factor
            if is_gap(name) and name not in meta.units:
                unit = {1.0: "m", 1e-3: "mm", 1e-6: "um"}[factor]
                text = f"array '{name}' has no unit; by its size it is taken to be in {unit}"
                found.append(Finding("gap-unit", "note", (), None, text))
        elif is_gap(name):
            bad = np.flatnonzero(~np.isfinite(values))
            why = f"row {bad[0]} is not finite" if len(bad) else f"{len(values)} rows of {rows}"
            text = f"array '{name}' is left out ({why}): kicks of its device are not told by it"
            found.append(Finding("gap-dropped", "warning", (), None, text))
    known = {channel: scaled[name] for name, channel in _NAMES.items() if name in scaled}
    return channels | known, found

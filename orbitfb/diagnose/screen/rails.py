"""Readings that are clipped: their extreme value comes again and again.

A BPM that stands still once says nothing of a rail, wherever it stands: it may be frozen. So the
longest stay is left out, and what is left must be there more often than chance brings it.
"""

import math

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.screen.steps import CHANCE, has_few_values, longest
from orbitfb.records.finding import Finding, counted, listed
from orbitfb.records.record import Record

RAIL = "rail"
"""Check that finds BPMs whose readings are clipped."""

_FEWEST = 12
_FACTOR = 4
_FEWEST_OTHERS = 20


def check_rails(record: Record) -> list[Finding]:
    """Find BPMs whose readings are clipped."""
    if has_few_values(record):
        return []
    found: list[Finding] = []
    for column in range(record.readings.shape[1]):
        readings = record.readings[:, column]
        moves = ~record.filled[:, column] & ~_stay(readings)
        # Every visit to the rail counts once.
        fresh = np.concatenate(([True], np.diff(readings) != 0.0))
        for sign, word in ((1.0, "above"), (-1.0, "below")):
            if not _at_rail(sign * readings[moves], sign * readings[moves & fresh]):
                continue
            label = record.layout.bpms.label(column)
            rail = sign * float(np.max(sign * readings[moves]))
            if np.any(sign * readings[~record.filled[:, column]] > sign * rail):
                continue  # it stands further out
            rows = np.flatnonzero(readings == rail)
            text = (
                f"{label} reads {rail * 1e6:.3f} µm in "
                f"{counted(len(rows), 'row')} and never goes {word}: its "
                "readings are clipped"
            )
            span = (int(rows[0]), int(rows[-1]))
            found.append(Finding(RAIL, "warning", (label,), span, text))
    if len(found) > max(2, record.readings.shape[1] // 4):
        names = [finding.devices[0] for finding in found]
        text = (
            f"{len(found)} BPMs return again and again to the same extreme reading: {listed(names)}"
        )
        return [Finding(RAIL, "note", tuple(dict.fromkeys(names)), None, text)]
    return found


def comes_back(readings: Vector, stay: Mask) -> bool:
    """Whether a BPM that stands still stands at its rail.

    Args:
        readings: Of the BPM, shape (N,) [m].
        stay: Rows of its stay, shape (N,).

    Returns:
        True if it never reads further out, and is there at other times, too, more often than
        readings on a grid would be there by chance.
    """
    others, value = readings[~stay], readings[stay][0]
    extreme = len(others) >= _FEWEST_OTHERS and (value >= others.max() or value <= others.min())
    again = int(np.count_nonzero(others == value))
    if not extreme or not again:
        return False
    elsewhere = others[others != value]
    _, counts = np.unique(elsewhere, return_counts=True)
    usual = float(np.sum(counts * (counts - 1))) / max(len(elsewhere) - 1, 1)
    if usual == 0.0:
        return True
    # Chernoff's bound of a Poisson number.
    return again > usual and again * math.log(again / usual) - again + usual > -math.log(CHANCE)


def _stay(readings: Vector) -> Mask:
    """Mark the rows of the longest stay, shape (N,)."""
    begin, end = longest(np.diff(readings) == 0.0)
    stay = np.zeros(len(readings), dtype=np.bool_)
    stay[begin : end + 1] = end > begin
    return stay


def _at_rail(values: Vector, visits: Vector) -> bool:
    """Whether the largest value comes more often than chance of few bits brings it."""
    if len(visits) < _FEWEST:
        return False
    top = values.max()
    count = np.count_nonzero(values == top)
    if count < _FEWEST or np.count_nonzero(visits == top) < 2:
        return False
    below = values[values < top]
    if not len(below):
        return False
    second = np.count_nonzero(values == below.max())
    return bool(count > _FACTOR * second + _FEWEST // 2)

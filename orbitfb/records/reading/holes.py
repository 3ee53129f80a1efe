"""Numbers that a record lacks, as archives have them: few are left out and told, many are refused.

A BPM without a reading is invalid in that row, and is filled in where the rows are joined. A row is
left out when most of its BPMs are invalid, or when it is not known what the correctors did. Where a
readback is missing the setpoint stands for it; a slow channel keeps its last value.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from orbitfb.core.errors import RecordError
from orbitfb.core.signals import Mask, Vector
from orbitfb.records.finding import Finding, counted, listed
from orbitfb.records.reading.raw import NUMBERS, Raw

MOST_OF_ROW = 0.5
"""Share of its BPMs that a row may lack, and of its rows that a record may [1]: beyond it, what is
there is the exception, and the file is another one than was meant."""

MOST_OF_CORRECTOR = 0.05
"""Share of the rows in which a corrector may be unknown [1]; as for BPMs, see `MOST_INVALID`."""

_MOVED = ("action", "setpoint", "dither")
_SLOW = ("current", "rf")


def without_holes(
    raw: Raw, rows: int, refuse: Callable[[str], RecordError]
) -> tuple[Raw, Mask, list[Finding]]:
    """Mark what is missing.

    Args:
        raw: The arrays, of matching shapes.
        rows: Of the record.
        refuse: Makes the error about an array: which value, in which row, and what to do.

    Returns:
        The arrays, in the rows to keep NaN where a BPM has no reading and finite elsewhere; which
        rows to keep, shape (rows,); what was found.

    Raises:
        RecordError: Too much is missing, or something that nothing can stand for.
    """
    numbers = dict(raw.numbers)
    there = {name: ~np.isfinite(numbers[name]) for name in NUMBERS if name in numbers}
    holes = {name: bad for name, bad in there.items() if bad.any()}
    found: list[Finding] = []
    keep: Mask = np.ones(rows, dtype=np.bool_)
    for name in ("orbit", "next_orbit"):
        if name in holes:
            numbers[name] = np.where(holes[name], np.nan, numbers[name])
    keep &= ~_empty([holes[name] for name in ("orbit", "next_orbit") if name in holes], rows)
    dead = holes.get("orbit", np.zeros(numbers["orbit"].shape, dtype=np.bool_)).all(axis=0)
    if "reference" in holes and not (holes["reference"] & ~dead).any():
        numbers["reference"] = np.where(holes["reference"], 0.0, numbers["reference"])
        del holes["reference"]
    for name in ("t", "model_R", "reference"):
        if name in holes:
            raise refuse(name)
    for name in _MOVED:
        if name not in holes:
            continue
        added_up = name == "action" and "setpoint" not in numbers
        if added_up or (holes[name][keep].mean(axis=0) > MOST_OF_CORRECTOR).any():
            raise refuse(name)
        keep &= ~holes[name].any(axis=1)
        numbers[name] = np.where(holes[name], np.nan, numbers[name])
    if np.count_nonzero(~keep) > MOST_OF_ROW * rows:
        raise refuse(max(holes, key=lambda name: np.count_nonzero(holes[name].any(axis=-1))))
    if not keep.all():
        at = np.flatnonzero(~keep)
        text = (
            f"{counted(len(at), 'row')} of {rows}, first row {at[0]} of the file, left out: most "
            "BPMs have no reading there, or what the correctors did is not known"
        )
        found.append(Finding("rows-left-out", "warning", (), None, text))
    found += _stand_ins(raw, numbers, holes)
    return replace(raw, numbers=numbers), keep, found


def _empty(holes: list[Mask], rows: int) -> Mask:
    """Tell the rows in which most BPMs have no reading, shape (rows,).

    Those are asked that have most readings, half of all, as the others may be dead.
    """
    empty: Mask = np.zeros(rows, dtype=np.bool_)
    for bad in holes:
        lacking = bad.mean(axis=0)
        working = lacking <= np.median(lacking)
        empty |= bad[:, working].mean(axis=1) > MOST_OF_ROW
    return empty


def _stand_ins(raw: Raw, numbers: dict[str, Vector], holes: dict[str, Mask]) -> list[Finding]:
    """Put setpoints for missing readbacks, and the last value for that of a slow channel."""
    found: list[Finding] = []
    if "readback" in holes:
        bad = holes["readback"]
        if bad.all() or "setpoint" not in numbers:
            del numbers["readback"]
            text = "array 'readback' is left out: it has no number, or there are no setpoints"
        else:
            numbers["readback"] = np.where(bad, numbers["setpoint"], numbers["readback"])
            columns = np.flatnonzero(bad.any(axis=0))
            names = raw.texts["corr_names"]
            devices = listed([names[column] for column in columns if column < len(names)])
            text = f"correctors have rows without a readback ({devices}); their setpoint is taken"
        found.append(Finding("missing-readback", "note", (), None, text))
    for name in _SLOW:
        if name not in holes:
            continue
        good = np.flatnonzero(~holes[name])
        if not len(good):
            del numbers[name]
            text = f"array '{name}' is left out: it has no number"
        else:
            last = np.searchsorted(good, np.arange(len(numbers[name])), side="right") - 1
            numbers[name] = numbers[name][good[np.maximum(last, 0)]]
            text = f"array '{name}' has {len(holes[name]) - len(good)} rows without a number; the "
            text += "last one stands there"
        found.append(Finding("missing-values", "note", (), None, text))
    return found

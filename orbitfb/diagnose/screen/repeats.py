"""Readings that repeat: frozen BPMs, orbits read twice, held readings.

Readings of few bits repeat by chance. How often is measured on the record itself (share of equal
neighbours of the BPM and of the median BPM), and a repetition counts only when chance does not
explain it in a million records.
"""

import math

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.screen.rails import RAIL, comes_back
from orbitfb.diagnose.screen.steps import CHANCE, has_few_values, inner, longest, runs
from orbitfb.estimation.priors import MOST_REPEATS
from orbitfb.records.finding import Finding, Severity, counted, listed
from orbitfb.records.record import Record

HELD = "held-readings"
"""Check that finds BPMs of which not every reading was recorded."""

_TOGETHER = 3
"""BPMs that repeat at once, at least, to be told as those of a crate."""
_MOSTLY_READ_TWICE = 0.5
"""Share of these rows in which a BPM repeats that belongs to them."""
_SHORTEST_FREEZE = 8
_WHOLE = 0.9
_FEWEST_BPMS = 4
_MOST_AT_ONCE = 0.5
"""Share of a record in which the orbit may stand still in one go."""
_PAIRS = 3
_COARSE = 0.25
_MARGIN = 1.5
_HELD = 0.05
"""Share of rows in which a reading that is held repeats."""
_MOSTLY = 0.8
"""Share of the values at which they stay, and of their steps, that come only once."""
_ALIKE = 1e-4
"""Share of the median step by which steps that are alike differ."""
_FEWEST_RUNS = 5
"""Times that they do."""


def check_repeats(record: Record) -> list[Finding]:
    """Find frozen BPMs and orbits that were read twice."""
    n = record.readings.shape[1]
    # equal[k]: reading k + 1 repeats reading k.
    equal, whole = _equal(record)
    if len(equal) and np.median(np.ptp(record.readings, axis=0)) == 0.0:
        return _whole_orbits(record, np.ones(len(equal), dtype=np.bool_))
    usual = float(np.median(equal.mean(axis=0)))
    single = equal & ~whole[:, None]
    held = _held(record, single)
    if 2 * len(held) > n:
        everywhere = _held_finding(record, held, single, everywhere=True)
        return [everywhere, *_all_frozen(record, single, whole, usual)]
    if usual > _COARSE and has_few_values(record):
        text = (
            f"{100 * usual:.0f} % of the readings equal the one before: a bit of the BPMs is "
            "larger than their noise, so only a BPM that stands still for long is seen to be "
            "frozen, and the noise model does not hold"
        )
        coarse = Finding("coarse-readings", "warning", (), None, text)
        return [coarse, *_all_frozen(record, single, whole, usual)]
    found = _whole_orbits(record, whole)
    if found and found[0].severity == "failure":
        return found
    usual = float(np.median(single.mean(axis=0)))
    found += _all_frozen(record, single, whole, usual)
    told = {name for finding in found if finding.effect for name in finding.devices}
    crate = _crates(record, told)
    known = {name for finding in crate for name in finding.devices}
    found = [*crate, *(one for one in found if one.effect or not known & set(one.devices))]
    held = [column for column in held if record.layout.bpms.label(column) not in told]
    return [_held_finding(record, held, single), *found] if held else found


def unread(record: Record) -> Mask:
    """Tell which readings only repeat the one before: of whole orbits, of crates, or held ones.

    Those of single BPMs that are held are left out, as these BPMs are.

    Returns:
        Shape (N, n).
    """
    equal, whole = _equal(record)
    same = np.zeros(record.readings.shape, dtype=np.bool_)
    if 2 * len(_held(record, equal & ~whole[:, None])) > equal.shape[1]:
        same[1:] = equal
        return same
    every = np.asarray(equal.all(axis=1))
    same[1:] = (equal & whole[:, None]) | every[:, None]
    return _together(_repeats(record)) | same


def _equal(record: Record) -> tuple[Mask, Mask]:
    """Which readings repeat the one before, (N - 1, n), and where whole orbits do, (N - 1,)."""
    n = record.readings.shape[1]
    equal: Mask = np.diff(record.readings, axis=0) == 0.0
    equal &= inner(record)[:, None] & ~record.filled[1:] & ~record.filled[:-1]
    # Beside the usual one, at most every tenth BPM may be frozen, so they do not hide a whole.
    whole: Mask = (equal.mean(axis=1) >= _WHOLE) & (n >= _FEWEST_BPMS)
    usual = float(np.median(equal[~whole].mean(axis=0))) if not whole.all() else 1.0
    if usual > 0.0 and usual ** (_WHOLE * n) * len(whole) > CHANCE:
        whole[:] = False
    return equal, whole


def _together(same: Mask) -> Mask:
    return same & (np.count_nonzero(same, axis=1) >= _TOGETHER)[:, None]


def _repeats(record: Record) -> Mask:
    """The same of single ones, too; none where readings of most BPMs repeat by chance, (N, n)."""
    same = np.zeros(record.readings.shape, dtype=np.bool_)
    same[1:] = (np.diff(record.readings, axis=0) == 0.0) & inner(record)[:, None]
    same[1:] &= ~record.filled[1:] & ~record.filled[:-1]
    same[np.mean(same, axis=1) >= _WHOLE] = False
    share = same.mean(axis=0)
    if np.median(share) > 0.0:
        return np.zeros_like(same)
    same[:, share >= _HELD] = False
    return same


def _by_chance(same: Mask, together: int, rows: int) -> bool:
    """Whether BPMs that repeat at the same rows may each do so by chance, as they do alone.

    Readings in single precision repeat some ten times in a hundred thousand.

    Args:
        same: All readings that repeat, shape (N, n).
        together: How many repeat at once.
        rows: In how many rows.
    """
    alone = np.count_nonzero(np.count_nonzero(same, axis=1) == 1)
    each = math.log(max(alone, 1) / same.size)
    tries = _log_choices(same.shape[1], together) + _log_choices(len(same), rows)
    return tries + rows * together * each > math.log(CHANCE)


def _log_choices(count: int, chosen: int) -> float:
    """Logarithm of the number of ways to choose some of many."""
    return math.lgamma(count + 1) - math.lgamma(chosen + 1) - math.lgamma(count - chosen + 1)


def _crates(record: Record, told: set[str]) -> list[Finding]:
    """Find BPMs that were not read at some ticks, all of a crate at once."""
    same = _repeats(record)
    shared = _together(same)
    rows = np.flatnonzero(shared.any(axis=1))
    labels = [record.layout.bpms.label(column) for column in range(shared.shape[1])]
    often = shared[rows].mean(axis=0) if len(rows) else np.zeros(len(labels))
    names = tuple(
        label for label, share in zip(labels, often, strict=True) if share > _MOSTLY_READ_TWICE
    )
    if len(names) < _TOGETHER or told & set(names) or _by_chance(same, len(names), len(rows)):
        return []
    why, effect = _missed(len(rows))
    text = (
        f"{listed(names)} repeat their readings, to the last bit, at the same "
        f"{counted(len(rows), 'row')} "
        f"(first {rows[0]}): {why}"
    )
    span = (int(rows[0]), int(rows[-1]))
    return [Finding("repeated-crate", "warning", names, span, text, effect=effect)]


def _held(record: Record, single: Mask) -> list[int]:
    """Find BPMs that stay for some rows again and again, each time at a value of its own."""
    share = single.mean(axis=0) if len(single) else np.zeros(single.shape[1])
    often = np.flatnonzero(share >= _HELD).tolist()
    return [c for c in often if _ever_another(record.readings[:, c], single[:, c])]


def _ever_another(readings: Vector, equal: Mask) -> bool:
    """Whether there is no rail at which readings stay, and no grid on which they move."""
    stays = np.array([readings[end] for _, end in runs(equal)])
    steps = np.abs(np.diff(readings))
    steps = steps[steps > 0.0]
    if len(stays) < _FEWEST_RUNS or not len(steps):
        return False
    steps = np.round(steps / (_ALIKE * np.median(steps)))
    return all(len(np.unique(v)) >= _MOSTLY * len(v) for v in (stays, steps))


def _missed(rows: int) -> tuple[str, str]:
    """What so many repeated rows are, in words, and the effect that they prove."""
    if rows > 1:
        return "those readings were missed and the old ones kept", "missed-read"
    return "a reading was missed, or a delay of one tick begins there", ""


def _held_finding(
    record: Record, columns: list[int], single: Mask, *, everywhere: bool = False
) -> Finding:
    share = float(np.median(single[:, columns].mean(axis=0)))
    names = tuple(record.layout.bpms.label(column) for column in columns)
    text = (
        f"{len(names)} BPMs repeat their readings to the last bit in {100 * share:.0f} % of the "
        f"rows, but never stay at one value again: {listed(names)}. They were held (by a dead-band "
        "or a slower rate of what recorded them), not read; record them at every tick"
    )
    severity: Severity = "failure" if everywhere and share > MOST_REPEATS else "warning"
    return Finding(HELD, severity, () if everywhere else names, None, text)


def _whole_orbits(record: Record, whole: Mask) -> list[Finding]:
    count = int(whole.sum())
    if not count:
        return []
    rows = np.flatnonzero(whole) + 1
    span = (int(rows[0]), int(rows[-1]))
    longest = max(end - begin for begin, end in runs(whole))
    if count > MOST_REPEATS * len(whole) or longest > _MOST_AT_ONCE * len(whole):
        text = (
            f"most BPMs stand still in {100 * count / len(whole):.0f} % of the rows; give a record "
            "in which the orbit was read"
        )
        return [Finding("frozen-orbit", "failure", (), span, text)]
    why, effect = _missed(count)
    text = (
        f"the whole orbit repeats the one before, to the last bit, in "
        f"{counted(count, 'row')} (first "
        f"{span[0]}): {why}"
    )
    return [Finding("repeated-orbit", "warning", (), span, text, effect=effect)]


def _all_frozen(record: Record, single: Mask, whole: Mask, usual: float) -> list[Finding]:
    """Find BPMs that stand still while the others move, and those that repeat now and then."""
    columns = np.flatnonzero(single.any(axis=0)).tolist()
    return [one for column in columns for one in _frozen(record, column, single, whole, usual)]


def _frozen(record: Record, column: int, single: Mask, whole: Mask, usual: float) -> list[Finding]:
    equal = single[:, column]
    # A whole orbit read twice does not thaw a frozen BPM, nor does a row that was lost.
    through = equal | ((whole | ~inner(record)) & (np.diff(record.readings[:, column]) == 0.0))
    begin, end = longest(through)
    length = end - begin
    outside = np.ones(len(equal), dtype=np.bool_)
    outside[begin:end] = False
    own = float(equal[outside].mean()) if outside.any() else 0.0
    others = float(np.median(single[begin:end].mean(axis=0))) if length else 0.0
    chance = min(_MARGIN * max(own, usual, others), 1.0)
    label = record.layout.bpms.label(column)
    tries = math.log(record.readings.size)
    likely = chance > 0.0 and tries + length * math.log(chance) > math.log(CHANCE)
    if length >= _SHORTEST_FREEZE and not likely:
        until = "to the end" if end == len(equal) else f"to row {end}"
        text = (
            f"{label} reads {record.readings[end, column] * 1e6:.3f} µm to the last bit from row "
            f"{begin} {until} ({length + 1} rows) while the others move"
        )
        stay = np.zeros(len(record), dtype=np.bool_)
        stay[begin : end + 1] = True
        if comes_back(record.readings[:, column], stay):  # as what is clipped does
            text += "; it never reads further out, so it may be clipped and not frozen"
            return [Finding(RAIL, "warning", (label,), (begin, end), text)]
        return [Finding("frozen-bpm", "warning", (label,), (begin, end), text, effect="bpm-stuck")]
    repeats = int(equal.sum())
    if usual == 0.0 and _PAIRS <= repeats < _HELD * len(equal):
        rows = np.flatnonzero(equal) + 1
        span = (int(rows[0]), int(rows[-1]))
        text = f"{label} repeats its previous reading, to the last bit, in {repeats} single rows"
        return [Finding("repeated-readings", "note", (label,), span, text)]
    return []

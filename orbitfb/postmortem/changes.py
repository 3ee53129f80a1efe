"""What changed in the last seconds, line by line."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfb.core.names import RF_FREQUENCY, RF_STEP, RF_TOLERANCE
from orbitfb.core.signals import LoopState
from orbitfb.history.columns import AUXILIARY
from orbitfb.postmortem.analysis import CURRENT
from orbitfb.postmortem.devices import interlocks_of, valid_of
from orbitfb.postmortem.reading import PostMortem
from orbitfb.safety.verdict import name_some

_SAID = {"loop_state_changed", "loop_reason_changed", "policy_swapped", "bpm_mask_changed"}
"""Events that the ticks tell themselves."""
_NOT_TOLD = {"logger", "figures"}
_LONGEST = 240
_DROP = 0.01
_TOLERANCE = 0.1
_RF, _RF_STEP = f"{AUXILIARY}{RF_FREQUENCY}", f"{AUXILIARY}{RF_STEP}"


@dataclass(frozen=True, slots=True)
class Change:
    """Something that changed.

    Args:
        since_trip: When [s].
        text: What, in words.
    """

    since_trip: float
    text: str


def changes(its: PostMortem, last: float) -> list[Change]:
    """List what changed from some time before the trip on, in order.

    Args:
        its: The post-mortem.
        last: How long before the trip to begin [s].
    """
    found = [*_of_ticks(its), *_of_events(its)]
    return sorted(
        (change for change in found if change.since_trip >= -last),
        key=lambda change: change.since_trip,
    )


def _of_ticks(its: PostMortem) -> Iterator[Change]:
    columns = its.columns
    states = its.states()
    tolerance = interlocks_of(its).readback_tolerance or _TOLERANCE
    limited = False
    for row in range(1, its.rows):
        for text in _of_row(its, row, (states[row - 1], states[row]), tolerance):
            yield Change(float(columns["since_trip"][row]), text)
        shortened = bool(columns["scale"][row] < 1.0)
        if shortened and not limited:
            scale = columns["scale"][row]
            yield Change(
                float(columns["since_trip"][row]), f"the limits shorten the change to {scale:.3g}"
            )
        limited = shortened


def _of_row(
    its: PostMortem, row: int, states: tuple[LoopState, LoopState], tolerance: float
) -> Iterator[str]:
    columns, (before, state) = its.columns, states
    reason = its.reasons[row]
    if state is not before:
        yield f"{before} → {state}" + (f": {reason}" if reason else "")
    elif reason != its.reasons[row - 1]:
        yield f"{state}: {reason}" if reason else f"{state}, with nothing to say any more"
    if columns["missed"][row]:
        count = int(columns["missed"][row])
        yield f"{count} orbit{'s' if count > 1 else ''} missed"
    old, new = (columns["policy_id"][each].decode(errors="replace") for each in (row - 1, row))
    if new != old:
        yield f"policy {new} instead of {old}"
    moved = np.abs(columns["reference"][row] - columns["reference"][row - 1]).max(initial=0.0)
    if moved > 0:
        yield f"the reference moved by up to {moved * 1e6:.3g} µm"
    if np.isfinite(columns["time"][row - 1 : row + 1]).all():
        yield from _of_readings(its, row, tolerance)
    for name, values in its.more.items():
        if values.dtype.kind == "S" and values[row] != values[row - 1]:
            yield f"{name}: {bytes(values[row]).decode(errors='replace')[:_LONGEST]}"


def _of_readings(its: PostMortem, row: int, tolerance: float) -> Iterator[str]:
    """Compare two orbits that followed each other."""
    columns = its.columns
    was, valid = valid_of(its, slice(row - 1, row + 1)) | ~its.counting
    for mask, what in ((was & ~valid, "became invalid"), (valid & ~was, "are valid again")):
        if mask.any():
            yield f"BPMs {what}: {name_some(mask, its.channels.bpms)}"
    expected = columns["setpoints"][row - 1] + columns["applied"][row - 1]
    difference = np.abs(columns["setpoints"][row] - expected)
    mask = difference > tolerance
    if mask.any():
        names = name_some(mask, its.channels.correctors)
        yield f"setpoints moved by somebody else, by up to {np.nanmax(difference):.3g} A: {names}"
    if CURRENT in columns:
        old, new = columns[CURRENT][row - 1 : row + 1]
        if not new >= old * (1.0 - _DROP) and np.isfinite(old):
            yield f"the stored current went from {old * 1e3:.4g} to {new * 1e3:.4g} mA"
    yield from _of_frequency(its, row)


def _of_frequency(its: PostMortem, row: int) -> Iterator[str]:
    """Tell steps of the RF frequency, ours and those of others."""
    none = np.zeros(its.rows)
    steps = np.nan_to_num(its.columns.get(_RF_STEP, none)[row - 1 : row + 1])
    if steps[1] != 0.0:
        yield f"the RF frequency was stepped by {steps[1]:+.3g} Hz"
    old, new = its.columns.get(_RF, none)[row - 1 : row + 1]
    # What we have put may show one orbit later.
    if abs(new - old) > RF_TOLERANCE and not (np.abs(new - old - steps) <= RF_TOLERANCE).any():
        yield f"the RF frequency went from {old:.3f} to {new:.3f} Hz, not by this loop"


def _of_events(its: PostMortem) -> Iterator[Change]:
    for event in its.events:
        if event.name not in _SAID:
            yield Change(event.since_trip, f"{event.name}{_told(event.fields)}")


def _told(fields: str) -> str:
    """Write the fields of an event in short."""
    try:
        found: Any = json.loads(fields)
    except (ValueError, RecursionError):
        return f": {fields[:_LONGEST]}"
    if not isinstance(found, dict):
        return ""
    said = [
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in found.items()
        if name not in _NOT_TOLD and value not in (None, "", [], {})
    ]
    return f": {', '.join(said)[:_LONGEST]}" if said else ""

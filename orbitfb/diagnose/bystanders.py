"""Leave out of a group what stands by, take in what belongs: a crate need not end with a cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.device_groups import groups_of
from orbitfb.diagnose.explain import Cause, actuated, restored
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.records.layout import Devices, Layout

_MOST = 40
"""Members up to which each is left out in turn: of a longer run a few more say little."""
_LEAST = 5.0
"""What leaving a member out, or taking one in, must gain beyond the choice of it [nats]."""
GAP = 2.0
"""What speaks against a gap among neighbours that share a rack [nats]."""
_IDLE = 1e-3
"""What a law does to a member, over the most that it does to one, below which it does nothing."""
_BUT = " without "


def without_bystander(bench: Bench, candidate: Candidate, cause: Cause) -> Candidate | None:
    """Find the member of a group without which it explains the record best.

    Healthy errors stay as they are: only a fit tells what leaving it out is worth.

    Args:
        bench: The record under the causes so far.
        candidate: A group of devices that are struck alike.
        cause: The same with its best values.

    Returns:
        The group without it; None where it is no group or all members are needed.
    """
    members = cause.places
    layout = bench.record.layout
    devices = {"bpm": layout.bpms, "corrector": layout.correctors}.get(cause.kind.target)
    if devices is None or not candidate.group or not 2 < len(members) <= _MOST:
        return None
    rest = [tuple(place for place in members if place != member) for member in members]
    heights = [log_likelihood(*bench.roughly((replace(cause, places=own),))) for own in rest]
    best = int(np.argmax(heights))
    choice = float(np.log(len(members)))
    if heights[best] < log_likelihood(*bench.roughly((cause,))) + choice + _LEAST:
        return None
    return replace(
        candidate,
        cause=replace(cause, places=rest[best]),
        choices=candidate.choices * len(members),
        group=_without(candidate.group, (devices.channels or devices.names)[members[best]]),
    )


def without_idle(bench: Bench, candidate: Candidate, cause: Cause) -> Candidate | None:
    """Find the likeliest group of a group's members that has all to which the law does anything.

    A limit that most of a long run of cells never reach is not seen to be theirs.

    Args:
        bench: The record under the causes so far.
        candidate: A group of devices that are struck alike.
        cause: The same with its best values.

    Returns:
        The smaller group (cells come before racks across them), or those members alone where none
        has them all, or there is one; None where the law does something to every one, or to none.
    """
    kind, record = cause.kind, bench.record
    if not candidate.group or not isinstance(kind, ActuatorKind | SensorKind):
        return None
    if kind.target == "ring" or len(cause.places) < 2:
        return None
    places = np.array(cause.places)
    if isinstance(kind, ActuatorKind):
        devices, weights = record.layout.correctors, np.linalg.norm(record.layout.response, axis=0)
        moved = actuated(record, (cause,)) - record.setpoints
    else:
        devices, weights = record.layout.bpms, 1.0
        moved = restored(record, (cause,))[0] - record.readings
    told = ~record.starts[1:]  # what stays as it is tells nothing, nor does a step that is free
    told &= ~(cause.free & (np.arange(1, len(record)) == cause.onset))
    steps = np.diff(moved, axis=0)[told]
    made = np.linalg.norm(steps, axis=0) * weights
    acting = set(places[made[places] > _IDLE * np.max(made[places])].tolist())
    if not 0 < len(acting) < len(places):
        return None
    able = [
        group
        for group in groups_of(devices)
        if acting <= set(group.members.tolist()) <= set(cause.places)
    ]
    if len(acting) == 1 or not able:
        own, group = tuple(sorted(acting)), ""
    else:
        group, members, _ = min(able, key=lambda one: (one.choices, len(one.members)))
        own = tuple(members.tolist())
    if own == cause.places:
        return None
    return replace(candidate, cause=replace(cause, places=own), group=group)


def with_neighbour(bench: Bench, candidate: Candidate, cause: Cause) -> Candidate | None:
    """Find the neighbour, or the next two, with which what is struck explains the record best.

    Args:
        bench: The record under the causes so far.
        candidate: One device or several.
        cause: The same with its best values; healthy errors stay as they are, as above.

    Returns:
        What is struck and the neighbour; None where nothing is gained by it.
    """
    kind, layout = cause.kind, bench.record.layout
    if not isinstance(kind, ActuatorKind | SensorKind) or not kind.collective:
        return None
    devices = layout.correctors if isinstance(kind, ActuatorKind) else layout.bpms
    if kind.target == "ring" or not 0 < len(cause.places) < len(devices) // 2:
        return None
    beside = _beside(devices, cause.places)
    if not beside:
        return None
    more = [tuple(sorted((*cause.places, *columns))) for columns, _ in beside]
    heights = [log_likelihood(*bench.roughly((replace(cause, places=own),))) for own in more]
    best = int(np.argmax([h - GAP * gap for h, (_, gap) in zip(heights, beside, strict=True)]))
    choice = float(np.log(len(more)))
    least = log_likelihood(*bench.roughly((cause,))) + choice + _LEAST
    if heights[best] < least + GAP * beside[best][1]:
        return None
    return replace(
        candidate,
        cause=replace(cause, places=more[best]),
        choices=candidate.choices * len(more),
        group="",
    )


def without_gaps(candidate: Candidate, cause: Cause, layout: Layout) -> Candidate | None:
    """Take in what stands between two that are struck; None where nothing does.

    Args:
        candidate: Devices that are struck alike.
        cause: The same with its best values.
        layout: The devices.
    """
    devices = layout.correctors if isinstance(cause.kind, ActuatorKind) else layout.bpms
    names, columns = _around(devices, cause.places)
    own = {devices.names[column] for column in cause.places}
    count = len(names)
    between = [
        name
        for index, name in enumerate(names)
        if name not in own and {names[index - 1], names[(index + 1) % count]} <= own
    ]
    if not between:
        return None
    added = [column for name in between for column in columns[name]]
    places = tuple(sorted((*cause.places, *added)))
    return replace(candidate, cause=replace(cause, places=places), group="")


def _around(devices: Devices, members: Sequence[int]) -> tuple[list[str], dict[str, list[int]]]:
    """Names of the devices around the ring, and their columns in the planes of some members."""
    columns: dict[str, list[int]] = {}
    planes = {devices.planes[column] for column in members}
    for column, name in enumerate(devices.names):
        if devices.planes[column] in planes:
            columns.setdefault(name, []).append(column)
    return list(columns), columns


def _beside(devices: Devices, members: Sequence[int]) -> list[tuple[tuple[int, ...], bool]]:
    """Columns of the devices next to members around the ring, in the planes of these.

    Returns:
        The next one on either side of each, the next two, or the second one with a gap.
    """
    names, columns = _around(devices, members)
    own = {devices.names[column] for column in members}
    found: dict[tuple[int, ...], bool] = {}
    for index in (i for i, name in enumerate(names) if name in own):
        for step in (-1, 1):
            first, second = (names[(index + step * far) % len(names)] for far in (1, 2))
            if first not in own:
                found[tuple(columns[first])] = False
                if second not in own:
                    found[tuple(sorted((*columns[first], *columns[second])))] = False
                    found.setdefault(tuple(columns[second]), True)
    return list(found.items())


def _without(group: str, name: str) -> str:
    whole, _, absent = group.partition(_BUT)
    return whole + _BUT + ", ".join([*filter(None, [absent]), name])

"""Leave out of a group what stands by, take in what belongs: a crate need not end with a cell."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.effects.device_kinds import ActuatorKind, SensorKind
from orbitfb.effects.layout import Devices

_MOST = 40
"""Members up to which each is left out in turn: of a longer run a few more say little."""
_LEAST = 5.0
"""What leaving a member out, or taking one in, must gain beyond the choice of it [nats]."""
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


def with_neighbour(bench: Bench, candidate: Candidate, cause: Cause) -> Candidate | None:
    """Find the neighbour with which devices that are struck alike explain the record best.

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
    more = [tuple(sorted((*cause.places, *columns))) for columns in beside]
    heights = [log_likelihood(*bench.roughly((replace(cause, places=own),))) for own in more]
    best = int(np.argmax(heights))
    choice = float(np.log(len(more)))
    if heights[best] < log_likelihood(*bench.roughly((cause,))) + choice + _LEAST:
        return None
    return replace(
        candidate,
        cause=replace(cause, places=more[best]),
        choices=candidate.choices * len(more),
        group="",
    )


def _beside(devices: Devices, members: Sequence[int]) -> list[tuple[int, ...]]:
    """Columns of the devices next to members around the ring, in the planes of these."""
    columns: dict[str, list[int]] = {}
    planes = {devices.planes[column] for column in members}
    for column, name in enumerate(devices.names):
        if devices.planes[column] in planes:
            columns.setdefault(name, []).append(column)
    names = list(columns)
    own = {devices.names[column] for column in members}
    at = [index for index, name in enumerate(names) if name in own]
    near = {names[(index + step) % len(names)] for index in at for step in (-1, 1)}
    return [tuple(columns[name]) for name in sorted(near - own, key=names.index)]


def _without(group: str, name: str) -> str:
    whole, _, absent = group.partition(_BUT)
    return whole + _BUT + ", ".join([*filter(None, [absent]), name])

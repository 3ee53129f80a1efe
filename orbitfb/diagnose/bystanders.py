"""Leave out of a group what stands by: a crate need not end where a cell does."""

from dataclasses import replace

import numpy as np

from orbitfb.diagnose.bench import Bench, log_likelihood
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause

_MOST = 40
"""Members up to which each is left out in turn: of a longer run a few more say little."""
_LEAST = 5.0
"""What leaving a member out must gain beyond the choice of it [nats]."""
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


def _without(group: str, name: str) -> str:
    whole, _, absent = group.partition(_BUT)
    return whole + _BUT + ", ".join([*filter(None, [absent]), name])

"""A post-mortem in words, and as values for a program."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from orbitfb.observe.plain import plain
from orbitfb.observe.wording import UNKNOWN, micrometres
from orbitfb.postmortem.analysis import Analysis, Sizes, analyse
from orbitfb.postmortem.changes import Change, changes
from orbitfb.postmortem.devices import Device
from orbitfb.postmortem.opening import number_of
from orbitfb.postmortem.reading import PostMortem

MOST_LINES = 40
"""Changes that are told to people; JSON has all of them."""


@dataclass(frozen=True, slots=True)
class Story:
    """What happened.

    Args:
        its: The post-mortem.
        analysis: Its figures; None when no tick is kept.
        changes: What changed in the last seconds and after the trip.
        last: Since when before the trip [s].
    """

    its: PostMortem
    analysis: Analysis | None
    changes: list[Change]
    last: float


def story_of(its: PostMortem, last: float) -> Story:
    """Look into a post-mortem.

    Args:
        its: As read.
        last: Changes are told from so long before the trip on [s].
    """
    return Story(its, analyse(its), changes(its, last), last)


def headline(its: PostMortem) -> str:
    """Say in one line what it is about."""
    what = {"trip": its.state, "fault": its.state, "command": "Frozen on request"}
    return f"{what.get(its.trigger, its.state) or UNKNOWN} at {moment(its)}"


def moment(its: PostMortem) -> str:
    """Write when the trip was, in local time."""
    return time_text(number_of(its.about, "time"))


def time_text(wall: float) -> str:
    """Write a time [s since the epoch] in local time with milliseconds."""
    try:
        when = datetime.fromtimestamp(wall).astimezone()
    except (ValueError, OverflowError, OSError):
        return UNKNOWN
    return when.isoformat(sep=" ", timespec="milliseconds")


def lines(story: Story) -> Iterator[str]:
    """Tell what happened, line by line; text that the file brought may hold any character."""
    its, found = story.its, story.analysis
    before = its.about.get("before")
    yield f"{headline(its)}, tick {its.about.get('tick')}" + (f", was {before}" if before else "")
    yield f"reason: {its.reason or UNKNOWN}"
    if found is None:
        yield "no tick is kept: the loop had not ticked"
        return
    since = its.columns["since_trip"]
    policies = its.about.get("policies")
    named = ", ".join(map(str, policies)) if isinstance(policies, list) else UNKNOWN
    yield (
        f"kept: {its.rows} ticks, {-since[0]:.1f} s before to {max(since[-1], 0.0):.1f} s after; "
        f"policy {named}"
    )
    yield f"orbit rms: {_sizes(found.orbit, micrometres)}"
    if found.peak_bpm:
        yield f"largest |orbit error| at the trip: {micrometres(found.peak)} at {found.peak_bpm}"
    yield f"stored current: {_sizes(found.current, milliamperes)}"
    yield f"first BPM: {_device(found.bpm) or 'none: no BPM was lost or left before the trip'}"
    yield f"first corrector: {_device(found.corrector) or 'none: all followed their setpoints'}"
    shown = story.changes[-MOST_LINES:]
    yield f"in the last {story.last:g} s, and after:" + ("" if shown else " nothing changed")
    if left := len(story.changes) - len(shown):
        yield f"  ({left} earlier changes are left out; --json has all of them)"
    for change in shown:
        yield f"  {change.since_trip:+8.2f} s  {change.text}"


def values(story: Story) -> dict[str, Any]:
    """Give what happened as JSON can hold it; SI units, what is unknown is None."""
    its, found = story.its, story.analysis
    said: dict[str, Any] = {**its.about, "path": str(its.path), "rows": its.rows}
    if found is not None:
        said |= {
            "orbit_rms": asdict(found.orbit),
            "largest_error": {"at": found.peak, "bpm": found.peak_bpm or None},
            "stored_current": asdict(found.current),
            "first_bpm": asdict(found.bpm) if found.bpm else None,
            "first_corrector": asdict(found.corrector) if found.corrector else None,
            "orbit_left": None
            if found.onset is None
            else float(its.columns["since_trip"][found.onset]),
        }
    return plain({**said, "changes": [asdict(change) for change in story.changes]})


def milliamperes(current: float) -> str:
    """Write a current [A] in mA."""
    return UNKNOWN if math.isnan(current) else f"{current * 1e3:.4g} mA"


def _sizes(sizes: Sizes, write: Any) -> str:
    return (
        f"{write(sizes.before)} before, {write(sizes.at)} at the trip, {write(sizes.after)} after"
    )


def _device(its: Device | None) -> str:
    if its is None:
        return ""
    others = f", with {its.others} others in the same tick" if its.others else ""
    return f"{its.name}, {its.since_trip:+.2f} s: {its.what}{others}"

"""Read a post-mortem, believing nothing that the file says before it is checked."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.signals import COUNTS, Channels, LoopState, Mask
from orbitfb.history.columns import AUXILIARY, STATES, Columns
from orbitfb.postmortem.content import (
    ABOUT,
    CONFIGURATION,
    LONGEST_EVENT,
    LONGEST_NAME,
    LONGEST_REASON,
    LONGEST_TEXT,
    MORE,
    MOST_NAMES,
    MOST_ROWS,
    plan,
)
from orbitfb.postmortem.datasets import Datasets
from orbitfb.postmortem.opening import opened, text_of

LARGEST = 2 * 2**30
"""Most that is read of a file, if nothing else is said [bytes]."""

_MOST_AUXILIARY = 1000
_MOST_MORE = 64
_MOST_EVENTS = 100_000
_PLANES = ("x", "y", "xy")


@dataclass(frozen=True, slots=True)
class LoggedEvent:
    """An event as it lies in the file.

    Args:
        since_trip: When, after the trip [s].
        level: Of the log.
        name: One word.
        fields: JSON of what else was logged; cut when it was long.
    """

    since_trip: float
    level: str
    name: str
    fields: str


@dataclass(frozen=True, slots=True)
class PostMortem:
    """What a file holds.

    Args:
        path: The file.
        about: What it says of itself; see `moment`, `state`, `reason`, `trigger`.
        configuration: TOML text.
        channels: The names behind the vectors.
        counting: BPMs that are not masked by configuration, shape (n,).
        columns: As in the archive, and `since_trip` [s], `ended` [s since the epoch], `phases`
            (rows, 5) [s].
        reasons: Why the loop was in its state, one per row.
        events: What was logged.
        more: Whatever else a record had, by name.
    """

    path: Path
    about: Mapping[str, Any]
    configuration: str
    channels: Channels
    counting: Mask
    columns: Columns
    reasons: tuple[str, ...]
    events: tuple[LoggedEvent, ...]
    more: Mapping[str, NDArray[Any]]

    @property
    def rows(self) -> int:
        """Number of ticks."""
        return len(self.reasons)

    @property
    def state(self) -> str:
        """State that it is about."""
        return text_of(self.about, "state")

    @property
    def reason(self) -> str:
        """Why the loop was in that state."""
        return text_of(self.about, "reason")

    @property
    def trigger(self) -> str:
        """`trip`, `fault` or `command`."""
        return text_of(self.about, "trigger")

    def states(self) -> list[LoopState]:
        """Give the state at the end of every tick."""
        return [STATES[number] for number in self.columns["state"]]


def read_postmortem(path: Path, largest: int = LARGEST) -> PostMortem:
    """Read a post-mortem.

    Args:
        path: The file.
        largest: Most that may be read [bytes].

    Raises:
        RecordError: It is no post-mortem, damaged, too large, or holds what makes no sense;
            says which array and row.
    """
    with opened(path) as file:
        return _read(Datasets(file, path, largest), path)


def _counts(
    data: Datasets, about: Mapping[str, Any], word: str, planes: str, size: int
) -> tuple[int, ...]:
    """Read how many devices each plane has; empty: as many in each."""
    counts = about.get(word, [])
    if not isinstance(counts, list) or not all(isinstance(its, int) and its > 0 for its in counts):
        raise data.wrong(ABOUT, f"has {word} {counts!r}, which are no counts")
    if counts and (len(counts) != len(planes) or sum(counts) != size):
        raise data.wrong(ABOUT, f"has {word} {counts!r} for {size} devices in planes {planes!r}")
    return tuple(counts)


def _read(data: Datasets, path: Path) -> PostMortem:
    about = data.mapping(ABOUT, LONGEST_TEXT)
    planes = text_of(about, "planes")
    if planes not in _PLANES:
        raise data.wrong(ABOUT, f"has planes {planes!r}, which are none of {', '.join(_PLANES)}")
    words = ("bpms", "correctors", "orbit_pvs", "setpoint_pvs", "readback_pvs")
    names = [data.texts(f"channels/{word}", MOST_NAMES, LONGEST_NAME) for word in words]
    each = [
        _counts(data, about, word, planes, len(its))
        for word, its in zip(COUNTS, names, strict=False)
    ]
    channels = Channels(planes, names[0], names[1], names[2], names[3], names[4], each[0], each[1])
    counts = (len(channels.bpms), len(channels.correctors))
    for word, its, wanted in zip(words[2:], names[2:], (*counts[:1], *counts[1:] * 2), strict=True):
        if len(its) != wanted:
            raise data.wrong(f"channels/{word}", f"has {len(its)} names, expected were {wanted}")
    shape, _ = data.shape("since_trip")
    if len(shape) != 1 or shape[0] > MOST_ROWS:
        raise data.wrong("since_trip", f"has shape {shape}, expected were at most {MOST_ROWS} rows")
    rows = shape[0]
    auxiliary = data.names(AUXILIARY[:-1], _MOST_AUXILIARY)
    columns = {
        name: data.read(name, (rows, *its), kind)
        for name, (kind, its) in plan(channels, auxiliary).items()
    }
    columns["state"] = columns["state"].astype(np.uint8)
    reasons = data.texts("reasons", MOST_ROWS, LONGEST_REASON)
    _check_rows(data, columns, len(reasons))
    return PostMortem(
        path=path,
        about=about,
        configuration="".join(data.texts(CONFIGURATION, 1, LONGEST_TEXT)),
        channels=channels,
        counting=data.read("channels/counting", counts[:1], np.dtype("?")),
        columns=columns,
        reasons=tuple(reasons[number] for number in columns["reason"]),
        events=_events(data),
        more=_more(data, rows),
    )


def _check_rows(data: Datasets, columns: Columns, reasons: int) -> None:
    """See that the columns make sense row by row.

    Raises:
        RecordError: One does not.
    """
    since = columns["since_trip"]
    for name, bad, problem in (
        ("state", columns["state"] >= len(STATES), "is no state"),
        ("reason", (columns["reason"] < 0) | (columns["reason"] >= reasons), "is no reason"),
        ("since_trip", ~np.isfinite(since) | (np.abs(since) > 1e6), "is no time [s]"),
        ("since_trip", np.diff(since, prepend=-np.inf) < 0, "goes back in time"),
        ("tick", columns["tick"] < 0, "is no count"),
    ):
        rows = np.flatnonzero(bad)
        if len(rows):
            raise data.wrong(name, f"holds {columns[name][rows[0]]!r}, which {problem}", rows[0])
    # Readings may be anything, and that is what a post-mortem is about; the reference is ours.
    rows = np.flatnonzero(~np.isfinite(columns["reference"]).all(axis=1))
    if len(rows):
        raise data.wrong("reference", "holds a number that is not finite", int(rows[0]))


def _events(data: Datasets) -> tuple[LoggedEvent, ...]:
    shape, _ = data.shape("events/since_trip")
    if len(shape) != 1 or shape[0] > _MOST_EVENTS:
        raise data.wrong("events/since_trip", f"has shape {shape}")
    times = data.read("events/since_trip", shape, np.dtype("<f8"))
    levels = data.texts("events/level", _MOST_EVENTS, LONGEST_NAME)
    names = data.texts("events/name", _MOST_EVENTS, LONGEST_NAME)
    told = data.texts("events/fields", _MOST_EVENTS, LONGEST_EVENT)
    for word, its in (("level", levels), ("name", names), ("fields", told)):
        if len(its) != len(times):
            raise data.wrong(f"events/{word}", f"has {len(its)} rows, expected were {len(times)}")
    return tuple(map(LoggedEvent, map(float, times), levels, names, told))


def _more(data: Datasets, rows: int) -> dict[str, NDArray[Any]]:
    """Read what a record had beside the columns, as far as it is numbers or short texts."""
    found: dict[str, NDArray[Any]] = {}
    names = data.names(MORE[:-1], _MOST_MORE) if data.has(MORE[:-1]) else []
    for name in names:
        shape, kind = data.shape(MORE + name)
        if shape[:1] != (rows,) or kind.kind not in "biufS" or kind.itemsize > LONGEST_REASON:
            raise data.wrong(MORE + name, f"has shape {shape} and type {kind}")
        found[name] = data.read(MORE + name, shape, kind)
    return found

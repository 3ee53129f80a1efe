"""Read an archive back: one segment, or a directory of them, joined in order."""

from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from orbitfb.core.errors import ArchiveError
from orbitfb.core.signals import Channels
from orbitfb.core.transitions import Transitions
from orbitfb.history.columns import Columns, transitions_of
from orbitfb.history.segment import UNFINISHED
from orbitfb.history.verify import CorruptSegmentError, SegmentContent, read_segment

LARGEST_ARCHIVE = 8 * 2**30
"""Most that is read into memory at once, if nothing else is said [bytes]."""


def read_archive(
    path: Path,
    channels: Channels | None = None,
    *,
    last: int | None = None,
    on_corrupt: Callable[[ArchiveError], None] | None = None,
    largest: int = LARGEST_ARCHIVE,
) -> Transitions:
    """Read the transitions of a segment, or of all segments in a directory, in order.

    An archive may be read while it is written.

    Args:
        path: A segment or a directory of segments.
        channels: The ring that it must be of; by default that of the latest segment.
        last: At most that many transitions, the latest ones; older segments are not opened.
        on_corrupt: Told of each segment that cannot be read, so that the others still are; by
            default the first one is an error.
        largest: Most that may be read into memory [bytes].

    Raises:
        ArchiveError: There is no segment, one is corrupt, they are of another ring or of
            several, or there is more than `largest`.
    """
    parts: list[SegmentContent] = []
    left, rows = largest, 0
    for segment in reversed(segment_paths(Path(path))):
        try:
            content = read_segment(segment, left)
        except FileNotFoundError:
            continue  # retention took it away since it was listed
        except CorruptSegmentError as error:
            if on_corrupt is None:
                raise
            on_corrupt(error)
            continue
        expected = channels or (parts[0].channels if parts else content.channels)
        _check_ring(content, expected)
        if content.rows:
            parts.append(content)
            left -= content.size
            rows += content.rows
        # Each run gives one transition less than it has rows.
        if last is not None and rows - len({part.run for part in parts}) >= last:
            break
    if not parts:
        raise ArchiveError(f"{path} holds no readable row; run the loop to record some")
    runs = [list(run) for _, run in groupby(reversed(parts), key=lambda part: part.run)]
    joined = concatenate([transitions_of(_stack([part.columns for part in run])) for run in runs])
    return joined if last is None else take(joined, slice(max(0, len(joined) - last), None))


def segment_paths(path: Path) -> list[Path]:
    """List the segments behind a path, the oldest first.

    Raises:
        ArchiveError: There is nothing at the path, or no segment in it.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise ArchiveError(f"there is no archive at {path}; name a segment or its directory")
    found = sorted(file for file in path.glob("*.h5") if not file.name.startswith(UNFINISHED))
    if not found:
        raise ArchiveError(f"there is no segment (*.h5) in {path}; run the loop to record some")
    return found


def take(transitions: Transitions, rows: slice) -> Transitions:
    """Give some rows of transitions."""
    columns = {
        name: getattr(transitions, name)[rows]
        for name in Transitions.__slots__
        if name != "auxiliary"
    }
    auxiliary = {name: column[rows] for name, column in transitions.auxiliary.items()}
    return Transitions(**columns, auxiliary=auxiliary)


def concatenate(parts: Sequence[Transitions]) -> Transitions:
    """Put transitions of the same channels one after the other; none pairs across parts."""
    if len(parts) == 1:
        return parts[0]
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Transitions.__slots__
        if name != "auxiliary"
    }
    return Transitions(
        **columns,
        auxiliary=_stack([dict(part.auxiliary) for part in parts], [len(p) for p in parts]),
    )


def _stack(parts: Sequence[Columns], lengths: Sequence[int] | None = None) -> Columns:
    """Concatenate columns; a slow channel that a part lacks is NaN there."""
    if len(parts) == 1:
        return parts[0]
    sizes = [len(part["tick"]) for part in parts] if lengths is None else lengths
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: np.concatenate(
            [
                part[name] if name in part else np.full(size, np.nan)
                for part, size in zip(parts, sizes, strict=True)
            ]
        )
        for name in names
    }


def _check_ring(content: SegmentContent, channels: Channels) -> None:
    """See that a segment is of the ring that is expected.

    Raises:
        ArchiveError: It is not.
    """
    for word, theirs, ours in (
        ("planes", (content.channels.planes,), (channels.planes,)),
        ("BPMs", content.channels.bpms, channels.bpms),
        ("correctors", content.channels.correctors, channels.correctors),
    ):
        if theirs != ours:
            first = next(
                (pair for pair in zip(theirs, ours, strict=False) if pair[0] != pair[1]), None
            )
            detail = (
                f"{first[0]} instead of {first[1]}" if first else f"{len(theirs)} of {len(ours)}"
            )
            raise ArchiveError(
                f"{content.path} is of another ring: its {word} differ ({detail}); name an archive "
                "of this ring, or keep one directory for each"
            )

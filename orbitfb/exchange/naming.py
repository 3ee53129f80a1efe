"""Which device of the ring is meant by a name of a file; nothing is guessed from the order."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Channels
from orbitfb.physics.places import Indices

_MOST_TOLD = 5


def bpm_labels(channels: Channels) -> dict[str, int]:
    """Map every way to name a reading to its place in an orbit."""
    return _labels(channels.bpms, channels.bpm_planes, (channels.orbit_pvs,))


def corrector_labels(channels: Channels) -> dict[str, int]:
    """Map every way to name a setpoint to its place."""
    return _labels(
        channels.correctors,
        channels.corrector_planes,
        (channels.setpoint_pvs, channels.readback_pvs),
    )


def plain_labels(names: Sequence[str], planes: Sequence[str]) -> tuple[str, ...]:
    """Name every element NAME:x or NAME:y, whatever the planes.

    Args:
        names: Of its devices.
        planes: Of each of them.
    """
    return tuple(f"{name}:{plane}" for name, plane in zip(names, planes, strict=True))


def places_of(names: Sequence[str], labels: dict[str, int], what: str, file: object) -> Indices:
    """Find the places of devices by their names.

    Args:
        names: As the file has them.
        labels: From `bpm_labels` or `corrector_labels`.
        what: `BPMs` or `correctors`, for messages.
        file: For messages.

    Returns:
        A place for every name, shape (k,).

    Raises:
        ExchangeError: A name is not of the ring, is ambiguous, or two mean the same.
    """
    unknown = [name for name in names if name not in labels]
    if unknown:
        shown = ", ".join(
            f"{name!r}{did_you_mean(name, labels, most=1)}" for name in unknown[:_MOST_TOLD]
        )
        more = f" and {len(unknown) - _MOST_TOLD} more" if len(unknown) > _MOST_TOLD else ""
        raise ExchangeError(
            f"{file}: {len(unknown)} of {len(names)} {what} are not of the configured ring: "
            f"{shown}{more}; use the names of its places table (NAME:x and NAME:y where there are "
            "both planes) or its PVs, or name its table with --places and its planes with --planes"
        )
    ambiguous = [name for name in names if labels[name] < 0]
    if ambiguous:
        raise ExchangeError(
            f"{file}: {what} {ambiguous[0]!r} may be of either plane; name them NAME:x and NAME:y, "
            "or say --order table where they stand in the order of the places table, x and then y"
        )
    places = [labels[name] for name in names]
    twice = [place for place, many in Counter(places).items() if many > 1]
    if twice:
        same = [name for name, place in zip(names, places, strict=True) if place == twice[0]]
        raise ExchangeError(
            f"{file}: {what} {' and '.join(map(repr, same[:_MOST_TOLD]))} are one device; leave "
            "one out"
        )
    return np.array(places, dtype=np.intp)


def places_or_none(
    names: Sequence[str], labels: dict[str, int], what: str, file: object
) -> tuple[Indices, tuple[str, ...]]:
    """Find the places of devices of which the ring may lack a few.

    Args:
        names: As the file has them.
        labels: From `bpm_labels` or `corrector_labels`.
        what: `BPMs` or `correctors`, for messages.
        file: For messages.

    Returns:
        A place for every name, shape (k,), −1 where the ring has none; and those names.

    Raises:
        ExchangeError: The ring lacks more than half, a name is ambiguous, or two mean the same.
    """
    unknown = tuple(name for name in names if name not in labels)
    if 2 * len(unknown) > len(names):
        places_of(names, labels, what, file)  # says which they are
    found = np.full(len(names), -1, dtype=np.intp)
    there = [number for number, name in enumerate(names) if name in labels]
    found[there] = places_of([names[number] for number in there], labels, what, file)
    return found, unknown


def _labels(
    names: Sequence[str], planes: Sequence[str], pvs: Sequence[Sequence[str]]
) -> dict[str, int]:
    found: dict[str, int] = {}
    for place, (name, label) in enumerate(zip(names, plain_labels(names, planes), strict=True)):
        found[label] = place
        found[name] = -1 if name in found else place
    for kind in pvs:
        found |= {pv: place for place, pv in enumerate(kind) if pv}
    return found

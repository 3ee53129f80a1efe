"""Devices of one kind that are off by the same: a family, told as one finding.

A ring with two kinds of electronics or of corrector magnets has gains around two values. The fewer
ones stand out of the many, all of them and by the same: one thing to look at, and not dozens.
"""

from dataclasses import replace

import numpy as np

from orbitfb.loco.named import Named

_LEAST = 4
"""Devices from which those that are off by the same are a family: three may be by chance."""

_APART = 1.5
"""Healthy spreads by which two neighbours of one family may differ [1]; of five devices with that
spread the widest gap is below it in three of four cases."""

_MOST_TOLD = 6


def as_families(named: list[Named], spread: float, others: str) -> list[Named]:
    """Put devices that are off by the same into one finding.

    Args:
        named: Gains or calibrations of one plane that stand out, along the ring.
        spread: Healthy spread of the group [1].
        others: What they do otherwise, for the sentence: `read`, `kick`.
    """
    found: list[Named] = []
    place_of = {its.places: number for number, its in enumerate(named)}
    for kind in dict.fromkeys(its.kind for its in named):
        own = sorted((its for its in named if its.kind == kind), key=lambda its: its.value)
        gaps = np.diff([its.value for its in own])
        ends = [*(np.flatnonzero(gaps > _APART * spread) + 1).tolist(), len(own)]
        begin = 0
        for end in ends:
            some = sorted(own[begin:end], key=lambda its: place_of[its.places])
            found += [_family(some, spread, others)] if len(some) >= _LEAST else some
            begin = end
    return found


def _family(members: list[Named], spread: float, others: str) -> Named:
    values = np.array([its.value for its in members])
    nearest = members[int(np.argmin(np.abs(values - np.median(values))))]
    places = tuple(place for its in members for place in its.places)
    told = ", ".join(places[:_MOST_TOLD]) + (" …" if len(places) > _MOST_TOLD else "")
    what = "BPMs" if nearest.kind.startswith("bpm") else "correctors"
    text = (
        f"{len(places)} {what} {others} {1 + values.mean():.3g} times what the others do, within "
        f"{100 * np.ptp(values) / 2:.2g} % ({told}): another family of them, or of what calibrates "
        f"them. The others scatter by {100 * spread:.2g} %."
    )
    return replace(
        nearest, places=places, value=float(values.mean()),
        sigma=float(np.sqrt(np.mean([its.sigma**2 for its in members]))), text=text,
    )  # fmt: skip

"""Families: devices of one kind whose values lie around another one than those of the others.

A ring with two kinds of electronics or of corrector magnets has gains around two values. Seen from
one middle they scatter widely, and hide what is wrong with one of them; seen from the middle of
its own family a device that is off stands out, and a family is one thing to look at and not dozens.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from orbitfb.core.robust import TO_SIGMA
from orbitfb.core.signals import Vector
from orbitfb.loco.named import Named
from orbitfb.physics.places import Indices

_LEAST = 4
"""Devices from which those that are off by the same are a family: three may be by chance."""

_GAP = 1.5
"""Standard deviations within the families from which a gap parts two of them [1]: 60 normal values
and more have such a gap, four and more on each side, in fewer than one of 1000 draws."""

_MIDDLES = 5.0
"""Standard deviations within the families that the middles of two neighbours are apart at least
[1], as of a device that stands out."""

_MOST_CUTS = 3
"""Widest gaps of a family that are tried, as the widest may be between two values far off."""

_MOST_TOLD = 6


def families_of(value: Vector, least: float) -> Indices:
    """Part values into families where there is a gap: 0 is the largest, others count from 1.

    Values are cut at the gap that is widest in standard deviations of what is then within the
    families, as long as one is wide enough.

    Args:
        value: Shape (k,).
        least: Smallest standard deviation within the families: what values are known to.
    """
    order = np.argsort(value)
    ordered, cuts = value[order], []
    while (cut := _next_cut(ordered, cuts, least)) is not None:
        cuts = sorted([*cuts, cut])
    groups = np.split(order, cuts)
    label = np.zeros(len(value), dtype=np.intp)
    for number, its in enumerate(sorted(groups, key=len, reverse=True)):
        label[its] = number
    return label


def middles(value: Vector, label: Indices) -> Vector:
    """Give every device the median of its family, shape (k,)."""
    found = np.empty(len(value))
    for number in np.unique(label):
        found[label == number] = np.median(value[label == number])
    return found


def _next_cut(ordered: Vector, cuts: Sequence[int], least: float) -> int | None:
    best, where = _GAP, None
    ends = [0, *cuts, len(ordered)]
    for begin, end in pairwise(ends):
        gaps = np.diff(ordered[begin:end])[_LEAST - 1 : end - begin - _LEAST]
        for number in np.argsort(-gaps)[:_MOST_CUTS]:
            cut = begin + _LEAST + int(number)
            within = max(_within(ordered, sorted([*cuts, cut])), least)
            apart = float(np.median(ordered[cut:end]) - np.median(ordered[begin:cut]))
            if gaps[number] > best * within and apart > _MIDDLES * within:
                best, where = float(gaps[number] / within), cut
    return where


def _within(ordered: Vector, cuts: Sequence[int]) -> float:
    """Robust standard deviation within the families."""
    apart = [np.abs(its - np.median(its)) for its in np.split(ordered, cuts)]
    return TO_SIGMA * float(np.median(np.concatenate(apart)))


def as_families(named: Sequence[Named], labels: Sequence[int], spread: float) -> list[Named]:
    """Put devices of one family into one finding.

    Args:
        named: Gains or calibrations of one plane that stand out, along the ring.
        labels: Family of each; 0 where it is in none but the largest.
        spread: Healthy spread of the group [1].
    """
    found = [its for its, label in zip(named, labels, strict=True) if label == 0]
    for number in sorted(set(labels) - {0}):
        members = [its for its, label in zip(named, labels, strict=True) if label == number]
        found.append(_family(members, spread))
    return found


def _family(members: list[Named], spread: float) -> Named:
    values = np.array([its.value for its in members])
    nearest = members[int(np.argmin(np.abs(values - np.median(values))))]
    places = tuple(place for its in members for place in its.places)
    told = ", ".join(places[:_MOST_TOLD]) + (" …" if len(places) > _MOST_TOLD else "")
    bpms = nearest.kind.startswith("bpm")
    text = (
        f"{len(places)} {'BPMs read' if bpms else 'correctors kick'} {1 + values.mean():.3g} "
        f"times what the others do, within {100 * np.ptp(values) / 2:.2g} % ({told}): another "
        f"family of devices, or of calibrations. The others scatter by {100 * spread:.2g} %."
    )
    return replace(
        nearest, places=places, value=float(values.mean()),
        sigma=float(np.sqrt(np.mean([its.sigma**2 for its in members]))), text=text,
    )  # fmt: skip

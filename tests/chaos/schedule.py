"""What happens when: drawn from a seed, before anything runs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.chaos.kinds import KINDS, Kind

PATTERNS = ("single", "overlapping", "flapping")
SHARES = (0.55, 0.3, 0.15)


@dataclass(frozen=True)
class Fault:
    """A fault, from and until [s] after the beginning of its episode."""

    kind: str
    where: str
    what: dict[str, Any]
    begin: float
    end: float


@dataclass(frozen=True)
class Episode:
    """Some faults after which the ring is whole again."""

    number: int
    pattern: str
    faults: tuple[Fault, ...]

    @property
    def seconds(self) -> float:
        """How long it takes until the last fault is gone [s]."""
        return max(fault.end for fault in self.faults)

    def changes(self) -> list[tuple[float, bool, int]]:
        """Give time, whether one begins, and which fault, in order of time."""
        ends = [(f.begin, True, i) for i, f in enumerate(self.faults)]
        return sorted(ends + [(f.end, False, i) for i, f in enumerate(self.faults)])


def schedule(seed: int, faults: int) -> Iterator[Episode]:
    """Draw episodes until there are so many faults; a flap counts each time."""
    rng = np.random.default_rng([seed, 20])
    drawn = number = 0
    while drawn < faults:
        kinds = [kind for kind in KINDS if not (kind.early and drawn > 0.5 * faults)]
        episode = _episode(rng, number, kinds, faults - drawn)
        drawn += len(episode.faults)
        number += 1
        yield episode


def _episode(rng: np.random.Generator, number: int, kinds: list[Kind], left: int) -> Episode:
    pattern = str(rng.choice(PATTERNS, p=SHARES))
    if pattern == "overlapping":
        first = [
            _fault(rng, _kind(rng, kinds), float(rng.uniform(0, 0.6)))
            for _ in range(int(rng.integers(2, 4)))
        ]
        return Episode(number, pattern, tuple(_apart(first)[:left]))
    fault = _fault(rng, _kind(rng, kinds), 0.0)
    if pattern == "single" or fault.where in ("ioc", "controller") or left < 2:
        return Episode(number, "single", (fault,))
    flaps, at = [], 0.0
    for _ in range(int(rng.integers(3, 7))):
        on, off = rng.uniform(0.04, 0.25, 2)
        flaps.append(Fault(fault.kind, fault.where, fault.what, at, at + float(on)))
        at += float(on + off)
    return Episode(number, pattern, tuple(flaps[:left]))


def _kind(rng: np.random.Generator, kinds: list[Kind]) -> Kind:
    weights = np.array([kind.weight for kind in kinds])
    return kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))]


def _fault(rng: np.random.Generator, kind: Kind, begin: float) -> Fault:
    return Fault(
        kind.name, kind.where, kind.draw(rng), begin, begin + float(rng.uniform(*kind.seconds))
    )


def _apart(faults: list[Fault]) -> list[Fault]:
    """Let each process suffer one thing at a time."""
    seen: set[str] = set()
    kept = []
    for fault in faults:
        if fault.where != "ring" and fault.where in seen:
            continue
        seen.add(fault.where)
        kept.append(fault)
    return kept

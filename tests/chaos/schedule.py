"""What happens when: drawn from a seed, before anything runs."""

from collections.abc import Collection, Iterator, Sequence
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

    @property
    def is_unanswered(self) -> bool:
        """Whether all its faults are devices that look well and do not answer."""
        return all("blind" in fault.what or "deaf" in fault.what for fault in self.faults)

    def changes(self) -> list[tuple[float, bool, int]]:
        """Give time, whether one begins, and which fault, in order of time."""
        ends = [(f.begin, True, i) for i, f in enumerate(self.faults)]
        return sorted(ends + [(f.end, False, i) for i, f in enumerate(self.faults)])


@dataclass(frozen=True)
class Lived:
    """An episode as it was: when its faults began, and when the last was gone [s since 1970]."""

    episode: Episode
    begin: float
    end: float


def schedule(seed: int, faults: int, kinds: Sequence[Kind] = KINDS) -> Iterator[Episode]:
    """Draw episodes until there are so many faults; a flap counts each time.

    Every kind comes once, in any order, before they come by their weights.

    Args:
        seed: Of the draw.
        faults: How many.
        kinds: Of which they are drawn; one at least may come at any time.
    """
    rng = np.random.default_rng([seed, 20])
    deck = _Deck(rng, kinds)
    drawn = number = 0
    while drawn < faults:
        deck.late = drawn > 0.5 * faults
        episode = _episode(rng, number, deck, faults - drawn)
        drawn += len(episode.faults)
        number += 1
        yield episode


class _Deck:
    """Kinds to draw from."""

    def __init__(self, rng: np.random.Generator, kinds: Sequence[Kind]) -> None:
        self._rng, self._kinds = rng, kinds
        self._new = [kinds[index] for index in rng.permutation(len(kinds))]
        self.late = False

    def draw(self, busy: Collection[str] = ()) -> Kind | None:
        """Draw a kind that does not do to a process what is being done to it; None: all are."""

        def fits(kind: Kind) -> bool:
            return kind.where not in busy and not (kind.early and self.late)

        for kind in self._new:
            if fits(kind):
                self._new.remove(kind)
                return kind
        kinds = [kind for kind in self._kinds if fits(kind)]
        if not kinds:
            return None
        weights = np.array([kind.weight for kind in kinds])
        return kinds[int(self._rng.choice(len(kinds), p=weights / weights.sum()))]


def _episode(rng: np.random.Generator, number: int, deck: _Deck, left: int) -> Episode:
    pattern = str(rng.choice(PATTERNS, p=SHARES))
    if pattern == "overlapping" and left > 1:
        drawn: list[Fault] = []
        for _ in range(min(left, int(rng.integers(2, 4)))):
            kind = deck.draw({fault.where for fault in drawn} - {"ring"})
            if kind is not None:
                drawn.append(_fault(rng, kind, float(rng.uniform(0, 0.6))))
        return Episode(number, pattern, tuple(drawn))
    kind = deck.draw()
    if kind is None:
        raise ValueError("every kind of fault that was asked for ends the life of a process")
    fault = _fault(rng, kind, 0.0)
    if pattern != "flapping" or fault.where in ("ioc", "controller") or left < 2:
        return Episode(number, "single", (fault,))
    flaps, at = [], 0.0
    for _ in range(min(left, int(rng.integers(3, 7)))):
        on, off = rng.uniform(0.04, 0.25, 2)
        flaps.append(Fault(fault.kind, fault.where, fault.what, at, at + float(on)))
        at += float(on + off)
    return Episode(number, pattern, tuple(flaps))


def _fault(rng: np.random.Generator, kind: Kind, begin: float) -> Fault:
    end = begin + float(rng.uniform(*kind.seconds))
    return Fault(kind.name, kind.where, kind.draw(rng), begin, end)

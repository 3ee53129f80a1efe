"""What follows a swap: is the orbit worse than it was, and must the former policy come back?

Ticks are counted as bad at two levels of the observed orbit, in units of what it was before the
swap: `learn.rollback_factor` f, and its square root, so that an orbit that is worse for good but
never by f is seen too. An orbit that is too large but falls is no ground to go back: something
kicked it, and the new policy corrects it. Above the lower level, ticks that fall count as neither
good nor bad. The others count when the orbit has not fallen for `learn.rollback_ticks` ticks, or
has come back in one step.

The former policy comes back when at one of the levels

- `learn.rollback_ticks` ticks in a row are bad, at f; or
- so many of the ticks since the swap are bad as would come by chance in one swap of a thousand,
  though nothing has changed. Bad ticks come by chance as often as before the swap: at most with
  the probability that the ticks before allow at 95 % confidence. The number of bad ticks is then
  binomial, and the thousandth is shared by all the looks of a watch, at both levels. An orbit that
  oscillates, and one that is worse for good, show in this.
"""

from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.core.transitions import Transitions
from orbitfb.learn.settings import LearnSettings

BASELINE = 100
"""Ticks before a swap that say what the orbit was."""

FALSE_ALARM = 1e-3
"""Probability that a swap is taken back though the orbit is as it was."""

_CONFIDENCE = 0.95
_FALLING = 0.98
"""An orbit below so much of the lowest one yet is on its way back [1]."""


def swap_cost(settings: LearnSettings) -> float:
    """Give the gain that pays for a swap, a ratio of the true orbit's rms [1].

    A gain whose 95 % interval does not hold is false with a probability of 1/40. The worst that a
    false one does without being taken back is the lower level of the watch, the square root of f,
    which is (f - 1) in the mean square, until the next refit; the worst that it does before it is
    taken back is (f² - 1) for `rollback_ticks` ticks. A gain of g is worth 2 g in the mean square
    until the next refit.

    Args:
        settings: Of watch and refits.
    """
    wrong = (1.0 - _CONFIDENCE) / 2.0
    factor = settings.rollback_factor
    noticed = (factor**2 - 1.0) * settings.rollback_ticks / settings.every
    return wrong * max(factor - 1.0, noticed) / 2.0


@dataclass(frozen=True, slots=True)
class Usual:
    """What the orbit was before a swap.

    Args:
        level: Median observed orbit, rms [m].
        chances: Most probable share of bad ticks at f and at its square root, nothing being
            wrong [1].
    """

    level: float
    chances: tuple[float, float]


def usual_of(observed: Vector, factor: float, level: float | None = None) -> Usual:
    """Say what the orbit was.

    Args:
        observed: Of the ticks before, rms, shape (T,) [m].
        factor: `learn.rollback_factor`.
        level: Its median, where the ticks themselves are no longer known [m]; then they are taken
            for as many as are looked at, none of them bad.
    """
    from scipy.special import betaincinv

    if level is None:
        level = float(np.median(observed)) if observed.size else np.inf
        count = max(int(observed.size), 1)
    else:
        count = BASELINE
    bad = [int(np.sum(observed > limit * level)) for limit in (factor, np.sqrt(factor))]
    chances = [float(betaincinv(k + 1, max(count - k, 1), _CONFIDENCE)) for k in bad]
    return Usual(level, (chances[0], chances[1]))


def prepare_watch() -> None:
    """Import what a watch counts with: half a second, better before the loop than beside it."""
    import scipy.special  # noqa: F401


@dataclass(slots=True)
class _Count:
    """Bad ticks at one level.

    Args:
        limit: Observed orbit that is too much, rms [m].
        chance: Share of bad ticks when nothing is wrong [1].
    """

    limit: float
    chance: float
    counted: int = 0
    bad: int = 0

    def add(self, is_bad: bool) -> None:
        """Count a tick."""
        self.counted += 1
        self.bad += is_bad

    def by_chance(self) -> float:
        """Give the probability of so many bad ticks if nothing is wrong."""
        from scipy.special import bdtrc

        return float(bdtrc(self.bad - 1, self.counted, self.chance)) if self.bad else 1.0


@dataclass(slots=True)
class Watch:
    """A swap under observation.

    Args:
        promoted: In force since the swap.
        former: In force before.
        usual: What the orbit was before.
        next_tick: First tick that has not been looked at.
        tripped_before: Whether the loop had tripped already at the swap.
        seen: Ticks that have been looked at.
    """

    promoted: Policy
    former: Policy
    usual: Usual
    next_tick: int
    tripped_before: bool = False
    seen: int = 0
    _lowest: float = np.inf
    _standing: int = 0
    _in_a_row: int = 0
    _pending: int = 0
    _counts: list[_Count] = field(default_factory=list["_Count"])

    def look(self, transitions: Transitions, settings: LearnSettings) -> str:
        """Look at what has happened since; say why to go back, or nothing.

        Args:
            transitions: Those since `next_tick`.
            settings: How much is too much.
        """
        if not self._counts:
            factors = settings.rollback_factor, float(np.sqrt(settings.rollback_factor))
            self._counts = [
                _Count(factor * self.usual.level, chance)
                for factor, chance in zip(factors, self.usual.chances, strict=True)
            ]
        for value in observed_rms(transitions):
            self.seen += 1
            if reason := self._judge(float(value), settings):
                return reason
        if len(transitions):
            self.next_tick = int(transitions.tick[-1]) + 1
        return ""

    def _judge(self, value: float, settings: LearnSettings) -> str:
        """Count one tick; say why to go back, or nothing."""
        high, low = self._counts
        least, rate = settings.rollback_ticks, FALSE_ALARM / (2.0 * settings.watch)
        away = not value <= low.limit
        lowest = self._lowest
        falling = away and value < _FALLING * lowest
        self._lowest = min(self._lowest, value) if away else np.inf
        self._standing = self._standing + 1 if away and not falling else 0
        self._in_a_row = self._in_a_row + 1 if not value <= high.limit and not falling else 0
        if self._in_a_row >= least:
            return f"after the swap the observed orbit stayed {self._above(high)} for {least} ticks"
        if away and not falling:
            self._pending += not value <= high.limit
            if self._standing < least:
                return ""  # it may be on its way back
            self._settle(high, counts=True)
            low.add(True)
        elif not away:
            # What came back at once, from above the upper level, is no orbit that was corrected.
            self._settle(high, counts=lowest > high.limit)
            high.add(False)
            low.add(False)
        for count in self._counts:
            if count.bad >= least and count.by_chance() <= rate:
                return (
                    f"after the swap the observed orbit was {self._above(count)} in {count.bad} "
                    f"of {count.counted} ticks; by chance that comes in one swap of a thousand"
                )
        return ""

    def _settle(self, high: _Count, counts: bool) -> None:
        """Count the ticks above the upper level of which it was not known what they are."""
        for _ in range(self._pending if counts else 0):
            high.add(True)
        self._pending = 0

    def _above(self, count: _Count) -> str:
        times = count.limit / self.usual.level
        return f"above {count.limit * 1e6:.3g} µm rms ({times:.1f} x what it was)"


def observed_rms(transitions: Transitions) -> Vector:
    """Rms of the orbit error of every closed tick, shape (T,) [m]."""
    closed = transitions.closed & transitions.valid.any(axis=1)
    error = (transitions.orbit - transitions.reference)[closed]
    valid = transitions.valid[closed]
    squares = np.where(valid, error, 0.0) ** 2
    return np.sqrt(squares.sum(axis=1) / np.maximum(valid.sum(axis=1), 1))

"""How an orbit recovers from kicks: figures from its rms by tick."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfb.core.signals import Vector

NEAR = 50e-6
"""First goal of a recovery: the paper's 0.05 mm [m]."""
FLOOR = 0.5e-6
"""Second goal: about the noise floor [m]."""
LATEST = 10
"""A kick that was asked for shows within so many ticks."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """What followed one kick.

    Args:
        tick: Of the first orbit with the kick in it.
        course: Rms of the true orbit from that tick on, shape (window,) [m]; NaN where it is
            not known.
        before: Median rms over the ticks before the kick [m].
    """

    tick: int
    course: Vector
    before: float

    @property
    def kick(self) -> float:
        """Rms of the first orbit with the kick in it [m]."""
        return float(self.course[0])

    @property
    def overshoot(self) -> float:
        """Largest later rms over the first one [1]; above 1 the loop made it worse."""
        later = self.course[1:][np.isfinite(self.course[1:])]
        return float(later.max() / self.kick) if later.size else float("inf")

    @property
    def end(self) -> float:
        """Median rms of the last tenth of the window [m]; inf when the loop did not get there."""
        last = self.course[-max(1, len(self.course) // 10) :]
        known = last[np.isfinite(last)]
        return float(np.median(known)) if known.size else float("inf")

    def steps_to(self, goal: float) -> float:
        """Count the corrections until the rms is first at or below a goal [m]; inf: never."""
        reached = np.flatnonzero(self.course <= goal)
        return float(reached[0]) if reached.size else float("inf")


def recoveries(true_rms: Vector, asked: Sequence[int], window: int) -> list[Recovery]:
    """Cut the recoveries out of a run.

    The kick shows one or two ticks after it was asked for: its tick is that of the largest step
    upwards among the next ones.

    Args:
        true_rms: By tick of the ring, shape (ticks,) [m]; NaN where unknown.
        asked: Ticks at which a kick was asked for.
        window: Ticks to keep of each.

    Returns:
        One for each kick whose window the run holds.
    """
    found: list[Recovery] = []
    for tick in asked:
        steps = np.diff(true_rms[tick : tick + LATEST + 1])
        if not np.isfinite(steps).any():
            continue
        first = tick + 1 + int(np.nanargmax(steps))
        course = true_rms[first : first + window]
        if len(course) == window:
            before = true_rms[max(0, tick - window // 2) : tick + 1]
            found.append(Recovery(first, course, float(np.nanmedian(before))))
    return found


def recovery_figures(found: Sequence[Recovery], planned: int) -> dict[str, float]:
    """Sum up the recoveries of a law.

    A kick that was not made, the loop having tripped, counts as one that it never recovered from.

    - `kicks`: how many were made; `recovered`: how many were at 0.05 mm within the window;
    - `kick`: median rms of the first orbit with the kick [m]; `before`: of the orbits before it;
    - `steps_to_near`, `steps_to_floor`: median over the kicks of the corrections until the true
      orbit is at 0.05 mm and at 0.5 µm; `…_worst`: of the slowest; inf: not within the window;
    - `overshoot_worst`: largest rms after any kick over that of the kick [1];
    - `end`: rms at the end of a window [m], median over the kicks; `end_worst`: the worst.

    Args:
        found: The recoveries.
        planned: How many kicks there should have been.
    """
    never = [float("inf")] * (planned - len(found))
    near = [recovery.steps_to(NEAR) for recovery in found] + never
    floor = [recovery.steps_to(FLOOR) for recovery in found] + never
    ends = [recovery.end for recovery in found] + never
    figures = {
        "kicks": float(len(found)),
        "recovered": float(np.isfinite(near).sum()),
        "steps_to_near": _median(near),
        "steps_to_near_worst": max(near),
        "steps_to_floor": _median(floor),
        "steps_to_floor_worst": max(floor),
        "end": _median(ends),
        "end_worst": max(ends),
    }
    if found:
        figures |= {
            "kick": _median([recovery.kick for recovery in found]),
            "before": _median([recovery.before for recovery in found]),
            "overshoot_worst": max(recovery.overshoot for recovery in found),
        }
    return figures


def mean_course(found: Sequence[Recovery]) -> tuple[Vector, Vector]:
    """Give the mean and the worst rms by tick after the kick, each of shape (window,) [m].

    Args:
        found: At least one recovery; ticks that are not known are left out of both.
    """
    courses = np.ma.masked_invalid([recovery.course for recovery in found])
    return courses.mean(axis=0).filled(np.nan), courses.max(axis=0).filled(np.nan)


def _median(values: Sequence[float]) -> float:
    """Give the upper median: with an even number no mean with an infinity."""
    return sorted(values)[len(values) // 2]

"""Figures of a method in a scenario, from curves that may come in pieces.

The mean curve is the mean over trajectories of the rms of the orbit, tick by tick. All that ends
in `_mm` is taken from it over the drift, before the re-kick; `final` is the mean of its last 100
ticks. What the readings show is `observed` and carries the reading noise; `true` is the beam.
A trajectory that passed 5 mm counts as 5 mm from there on. The ratio to the LQG floor is that of
the rms over trajectories and ticks, as the floor is: the mean of an rms is smaller.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.evaluate.paper.environment import Curves
from orbitfb.evaluate.paper.scenarios import Scenario

LAST = 100
_NEAR = 0.05e-3
_FLOOR = 0.3e-6
_BACK = 0.5e-6
_MM = 1e3


@dataclass(frozen=True, slots=True)
class Summary:
    """What is kept of a batch of trajectories; batches can be put together.

    Curves have shape (steps + after + 1,) [m], figures shape (N,); steps that were never reached
    are NaN.

    Args:
        observed_sum: Sum over trajectories of the rms of the readings.
        true_sum: The same of the true orbits.
        true_square_sum: Sum over trajectories of the mean square of the true orbits [m²].
        observed_worst: Largest rms of the readings.
        true_worst: The same of the true orbits.
        near: Ticks until the readings' rms is at most 0.05 mm.
        floor: Ticks until the true rms is at most 0.3 µm.
        lost: 1 where the trajectory was lost, or ended the drift above its start; else 0.
        kick_near: Ticks after the re-kick until the true rms is at most 0.05 mm.
        kick_back: Ticks after the re-kick until the true rms is at most 0.5 µm.
        kick_peak: Largest true rms after the re-kick, over that right after it.
    """

    observed_sum: Vector
    true_sum: Vector
    true_square_sum: Vector
    observed_worst: Vector
    true_worst: Vector
    near: Vector
    floor: Vector
    lost: Vector
    kick_near: Vector
    kick_back: Vector
    kick_peak: Vector

    def arrays(self) -> dict[str, Vector]:
        """Give all of it by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def summarise(curves: Curves, steps: int) -> Summary:
    """Reduce the curves of a batch.

    Args:
        curves: Of the whole run.
        steps: Length of the drift [ticks].
    """
    drift, after = curves.true[:, :steps], curves.true[:, steps:]
    ended = np.mean(drift[:, -LAST:], axis=1) > drift[:, 0]
    return Summary(
        observed_sum=np.sum(curves.observed, axis=0),
        true_sum=np.sum(curves.true, axis=0),
        true_square_sum=np.sum(curves.true**2, axis=0),
        observed_worst=np.max(curves.observed, axis=0),
        true_worst=np.max(curves.true, axis=0),
        near=_first(curves.observed[:, :steps], _NEAR),
        floor=_first(drift, _FLOOR),
        lost=(curves.lost | ended).astype(np.float64),
        kick_near=_first(after, _NEAR),
        kick_back=_first(after, _BACK),
        kick_peak=np.max(after, axis=1) / after[:, 0],
    )


def combine(parts: Sequence[Mapping[str, Vector]]) -> Summary:
    """Put batches of the same scenario and method together, in their order.

    Args:
        parts: Of each batch, its `Summary.arrays()`.
    """

    def one(name: str) -> Vector:
        values = [np.asarray(part[name], dtype=np.float64) for part in parts]
        if name.endswith("_sum"):
            return np.sum(values, axis=0)
        return np.max(values, axis=0) if name.endswith("_worst") else np.concatenate(values)

    return Summary(**{field.name: one(field.name) for field in fields(Summary)})


def figures(summary: Summary, scenario: Scenario) -> dict[str, Any]:
    """Give the figures of a method; a number of steps that was never reached is None.

    Args:
        summary: Of all its trajectories.
        scenario: What happened.
    """
    count = len(summary.near)
    observed = summary.observed_sum[: scenario.steps] / count
    true = summary.true_sum[: scenario.steps] / count
    final_true = float(np.mean(true[-LAST:]))
    answer: dict[str, Any] = {
        "trajectories": count,
        "min_rms_mm": float(np.min(observed)) * _MM,
        "max_rms_mm": float(np.max(observed)) * _MM,
        "final_rms_mm": float(np.mean(observed[-LAST:])) * _MM,
        "final_true_rms_mm": final_true * _MM,
        "steps_to_0p05": _steps(_first(observed[None], _NEAR)[0]),
        "steps_to_0p05_worst": _steps(_largest(summary.near)),
        "steps_to_0p3um_median": _steps(_median(summary.floor)),
        "diverged": int(np.sum(summary.lost)),
    }
    if scenario.after > 0:
        answer["rekick"] = {
            "steps_to_0p05_median": _steps(_median(summary.kick_near)),
            "steps_to_0p05_worst": _steps(_largest(summary.kick_near)),
            "steps_to_0p5um_median": _steps(_median(summary.kick_back)),
            "steps_to_0p5um_worst": _steps(_largest(summary.kick_back)),
            "max_over_kick": float(np.max(summary.kick_peak)),
            "max_over_kick_median": float(np.median(summary.kick_peak)),
        }
    floor = lqg_floor(scenario)
    if floor > 0.0:
        squares = summary.true_square_sum[: scenario.steps][-LAST:] / count
        answer["true_over_lqg_floor"] = float(np.sqrt(np.mean(squares))) / floor
    return answer


def lqg_floor(scenario: Scenario) -> float:
    """Give the rms of the true orbit that no law falls below at rest [m].

    Along the eigenvectors of the covariance of the orbit's steps, every mode is a random walk
    with variance q² per tick, read with noise r². With ρ = q / r the stationary Kalman filter
    predicts it with the variance r² (ρ² + ρ √(ρ² + 4)) / 2, and a change can take away what is
    predicted, no more. The drift of R is taken as known.

    Args:
        scenario: With its walk; without one the floor is 0.
    """
    n = len(scenario.start)
    steps = scenario.white**2 * np.eye(n)
    if scenario.walk is not None:
        steps += scenario.walk @ scenario.walk.T
    noise = scenario.reading_noise**2
    ratio = np.clip(np.linalg.eigvalsh(steps), 0.0, None) / noise
    predicted = 0.5 * noise * (ratio + np.sqrt(ratio * (ratio + 4.0)))
    return float(np.sqrt(np.mean(predicted)))


def _first(curves: Vector, level: float) -> Vector:
    """Give the first tick at which each curve is at most a level; NaN where none is."""
    below = curves <= level
    return np.where(below.any(axis=1), np.argmax(below, axis=1).astype(np.float64), np.nan)


def _largest(steps: Vector) -> float:
    return float(np.max(np.where(np.isnan(steps), np.inf, steps)))


def _median(steps: Vector) -> float:
    """Give the median; never counts as longest, and half a step as a whole one."""
    return float(np.sort(np.where(np.isnan(steps), np.inf, steps))[len(steps) // 2])


def _steps(value: float) -> int | None:
    return int(value) if np.isfinite(value) else None

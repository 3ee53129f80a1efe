"""The paper's figures, what ours have to reach, and whether they do."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

PAPER: Mapping[str, Mapping[str, float | None]] = {
    "svd": {"min_rms_mm": 0.021, "max_rms_mm": 0.25, "final_rms_mm": 0.026, "steps_to_0p05": 532},
    "supervised": {
        "min_rms_mm": 0.12,
        "max_rms_mm": 0.35,
        "final_rms_mm": 0.16,
        "steps_to_0p05": None,
    },
    "model-based-rl-verbatim": {
        "min_rms_mm": 0.00028,
        "max_rms_mm": 0.25,
        "final_rms_mm": 0.00033,
        "steps_to_0p05": 187,
    },
}
"""Table 1 of Dong, Tian, Sun, by the method here that stands for the row; None: never."""

OURS = "model-based-rl"

BIAS = "naive refit"
"""Stands for a scenario: what the naive estimate makes of a loop at its noise floor."""

Found = Mapping[str, Mapping[str, Mapping[str, Any]]]
"""Figures by scenario and method."""


@dataclass(frozen=True, slots=True)
class Target:
    """A bar: where a figure of a method in a scenario has to lie.

    Args:
        scenario: Its name.
        method: Its name.
        figure: Path in the figures, parts joined by a dot.
        largest: Upper bound; None: there is none.
        smallest: Lower bound; None: there is none. Without any bound it must never be reached.
        over: Another method; the figure is the ratio to that one's.
        under: Another method; the figure is the ratio of that one's to this one's.
    """

    scenario: str
    method: str
    figure: str
    largest: float | None = None
    smallest: float | None = None
    over: str = ""
    under: str = ""


@dataclass(frozen=True, slots=True)
class Verdict:
    """A target and what was found.

    Args:
        target: The bar.
        value: The figure; None: never reached.
        reached: Whether it lies where it has to.
    """

    target: Target
    value: float | None
    reached: bool

    def as_json(self) -> dict[str, Any]:
        """Give it as JSON."""
        return {**asdict(self.target), "value": self.value, "reached": self.reached}


def _row(method: str, **shares: float) -> tuple[Target, ...]:
    """Make the targets of a row of the paper that is to be reproduced in E1."""
    targets: list[Target] = []
    for figure, value in PAPER[method].items():
        if value is None:
            targets.append(Target("E1", method, figure))
        else:
            share = shares[figure]
            targets.append(Target("E1", method, figure, value * (1 + share), value * (1 - share)))
    return tuple(targets)


def _floor(scenario: str, **largest: float) -> tuple[Target, ...]:
    bounds = {"min_rms_mm": 0.000201, "max_rms_mm": 0.2505, "final_rms_mm": 0.000205, "diverged": 0}
    return tuple(
        Target(scenario, OURS, figure, bound) for figure, bound in {**bounds, **largest}.items()
    )


TARGETS: tuple[Target, ...] = (
    *_row("svd", min_rms_mm=0.15, max_rms_mm=0.02, final_rms_mm=0.15, steps_to_0p05=0.08),
    *_row("supervised", min_rms_mm=0.3, max_rms_mm=0.3, final_rms_mm=0.5),
    Target("E1", "supervised-right", "min_rms_mm", 1.1, over="svd"),
    Target("E1", "supervised-right", "final_rms_mm", 1.1, over="svd"),
    Target("E1", "supervised-right", "steps_to_0p05", 1.1, over="svd"),
    Target(BIAS, "gain 1", "bias", 1.1, 0.9),
    Target(BIAS, "gain 0.3", "bias", 1.1, 0.9),
    Target("s3", "model-based-rl-verbatim", "diverged", smallest=1),
    Target("s3", "naive-refit", "diverged", smallest=1),
    *_floor("E1", final_true_rms_mm=0.035e-3, steps_to_0p05=1),
    Target("E1", f"{OURS}-memoryless", "final_true_rms_mm", 0.05e-3),
    *_floor("E2", final_true_rms_mm=0.035e-3, steps_to_0p05=2, steps_to_0p05_worst=4),
    Target("E2", f"{OURS}-memoryless", "final_true_rms_mm", 0.05e-3),
    Target("E2", OURS, "final_rms_mm", smallest=100, under="svd"),
    Target("E2", OURS, "final_rms_mm", smallest=10, under="svd-best"),
    Target("E2", OURS, "rekick.steps_to_0p05_median", 25),
    Target("E2", OURS, "rekick.max_over_kick", 1.0),
    *_floor("E2h", steps_to_0p05=5, steps_to_0p05_worst=40),
    Target("s1", OURS, "true_over_lqg_floor", 1.03),
    Target("s2", OURS, "true_over_lqg_floor", 1.08),
    Target("s3", OURS, "true_over_lqg_floor", 1.2),
    Target("s2", OURS, "rekick.steps_to_0p05_median", 3),
    Target("s3", OURS, "rekick.steps_to_0p05_median", 6),
    Target("s2", OURS, "final_true_rms_mm", smallest=1.3, under="svd-best"),
    Target("s3", OURS, "final_true_rms_mm", smallest=2.0, under="svd-best"),
    *(Target(scenario, OURS, "diverged", 0) for scenario in ("s1", "s2", "s3")),
)


def judge(found: Found) -> list[Verdict]:
    """Compare what was found with the targets; what was not run is left out."""
    verdicts: list[Verdict] = []
    for target in TARGETS:
        methods = found.get(target.scenario, {})
        needed = {target.method, target.over or target.method, target.under or target.method}
        if needed <= methods.keys():
            value = _value(target, methods)
            verdicts.append(Verdict(target, value, _reached(target, value)))
    return verdicts


def _value(target: Target, methods: Mapping[str, Mapping[str, Any]]) -> float | None:
    own = look_up(methods[target.method], target.figure)
    if not (target.over or target.under):
        return own
    other = look_up(methods[target.over or target.under], target.figure)
    if own is None or other is None:
        return None
    return own / other if target.over else other / own


def _reached(target: Target, value: float | None) -> bool:
    if target.largest is None and target.smallest is None:
        return value is None
    if value is None:
        return False
    above = target.smallest is None or value >= target.smallest
    return above and (target.largest is None or value <= target.largest)


def look_up(figures: Mapping[str, Any], path: str) -> float | None:
    """Give a figure by its path; None where it was never reached or is not there."""
    value: Any = figures
    for part in path.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return None if value is None else float(value)

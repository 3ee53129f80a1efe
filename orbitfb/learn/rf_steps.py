"""What steps of the RF frequency, which the loop makes, leave of the orbit under two laws.

With a step h goes the change that undoes it, by the response and the RF column that a law knows. On
a ring that is not quite so an orbit stays, h (d + R p) with p the change per hertz, which the law
then corrects. Many steps are a random kick of that shape.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfb.core.ports import Policy
from orbitfb.core.signals import Vector
from orbitfb.models.column import RfColumn
from orbitfb.physics.frequency import undoing
from orbitfb.policies.rf_known import rf_of
from orbitfb.safety.frequency import column_fault


@dataclass(frozen=True, slots=True, eq=False)
class RfSteps:
    """The steps of a loop, and what goes with them under two laws.

    Args:
        column: What is known of the RF column.
        size: Steps per tick, rms [Hz].
        patterns: Change per hertz of either law, shape (m,) [A/Hz].
    """

    column: RfColumn
    size: float
    patterns: tuple[Vector, Vector]

    def kicks(
        self, error: Vector, response: Vector, modes: Vector, generator: np.random.Generator
    ) -> tuple[Vector, Vector]:
        """Draw what is left of the steps of a tick under either law, shape (n,) [m] rms.

        Args:
            error: Rows of Uᵀ(R − R̂) of the response drawn, shape (n, m) [m/A].
            response: That response, shape (n, m) [m/A].
            modes: U, shape (n, n).
            generator: For the column.
        """
        column = self.column.drawn_with(error, modes, generator)
        ours, theirs = (self.size * (column + response @ pattern) for pattern in self.patterns)
        return ours, theirs


def rf_steps(
    column: RfColumn | None, ours: Policy, theirs: Policy, square: float
) -> RfSteps | None:
    """Say what the steps of a loop leave; None: it makes none, or a law has no response.

    Args:
        column: What is known of the RF column; None: the RF does not step.
        ours: A law.
        theirs: Another one.
        square: Mean square of the step of a tick [Hz²].
    """
    if column is None or square == 0.0:
        return None
    patterns: list[Vector] = []
    for policy in (ours, theirs):
        own: Any = policy
        response = getattr(own, "response", None)
        if response is None:
            return None
        known = rf_of(policy) or column.told
        movable = getattr(own, "movable", np.ones(response.shape[1], dtype=np.bool_))
        patterns.append(undoing(response, known.response, movable))
    return RfSteps(column, float(np.sqrt(square)), (patterns[0], patterns[1]))


def rf_figures(column: RfColumn | None, steps: int) -> dict[str, float]:
    """Give what was found of the RF column, for a report: its ratio to the one told, 95 %.

    Args:
        column: What is known of it; None: the RF does not step.
        steps: Steps that it was learnt from.
    """
    if column is None:
        return {}
    return {
        "rf_ratio": column.ratio,
        "rf_ratio_low": column.ratio - 1.96 * column.sigma,
        "rf_ratio_high": column.ratio + 1.96 * column.sigma,
        "rf_steps": float(steps),
    }


def rf_told(reason: str, column: RfColumn | None, steps: int) -> str:
    """Add to the reason of a report what was found of the RF column.

    Args:
        reason: So far.
        column: What is known of it; None: the RF does not step.
        steps: Steps that it was learnt from; without any there is nothing to say.
    """
    if column is None or steps == 0:
        return reason
    its = rf_figures(column, steps)
    told = (
        f"RF column {its['rf_ratio']:.3f} [{its['rf_ratio_low']:.3f}, {its['rf_ratio_high']:.3f}]"
    )
    refused = rf_refusal(column)
    return f"{reason}; {told} of the one told" + (f"; {refused}" if refused else "")


def rf_refusal(column: RfColumn | None) -> str:
    """Say why a column that was identified must not be used; empty: it may."""
    fault = "" if column is None else column_fault(column.ratio)
    return f"the RF column that was identified is not taken: {fault}" if fault else ""

"""The RF column of the response: one more actuator, whose unit is Hz, beside the correctors.

A step h of the RF frequency that goes with a change a moves the orbit by R a + d h. So d is one
more column of R and h one more regressor, and R̂ and d̂ are one posterior. d begins as the
dispersion of the places table tells it, with an error that is stated (`rf_error`).

A table may be wrong in all places alike (momentum compaction, energy), or place by place. Rows of
UᵀR are independent in the regression, so that it knows of the second alone. With β an error that
all rows share, of the columns V (that of the RF, and the part of R that goes with the energy), the
prior mean of row i is μ_i + d_i V β. From the prior covariance P of a row and its posterior m_i, C
around μ_i follows, β normal around 0 with the stated error as well,

    pull  Σ_i d_i Vᵀ P⁻¹ (m_i − μ_i),   information  Σ_i d_i² Vᵀ P⁻¹ (P − C) P⁻¹ V,

and the rows move by C P⁻¹ V β d_i.

Source: the normal hierarchical model, e.g. Gelman et al., Bayesian Data Analysis (2013), ch. 5.
"""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import KnownRf
from orbitfb.physics.places import Indices


@dataclass(frozen=True, slots=True, eq=False)
class RfColumn:
    """What is known of the RF column.

    Args:
        told: What the places table says; its column is d0.
        response: d̂, shape (n,) [m/Hz].
        ratio: Its size over that of the one told: slope of d̂ on d0 [1].
        sigma: Standard deviation of the ratio [1].
        slopes: Regression of a mode's d on its row of UᵀR, by mode, shape (n, m) [A/Hz].
        spread: Standard deviation of a mode's d when its row of UᵀR is known, shape (n,) [m/Hz].
    """

    told: KnownRf
    response: Vector
    ratio: float
    sigma: float
    slopes: Vector
    spread: Vector

    @property
    def known(self) -> KnownRf:
        """What is known of the RF by now."""
        return replace(self.told, response=self.response, identified=True)

    def drawn_with(self, error: Vector, modes: Vector, generator: np.random.Generator) -> Vector:
        """Draw a column that the data allow beside a drawn response, shape (n,) [m/Hz].

        Args:
            error: Rows of Uᵀ(R − R̂) as drawn, shape (n, m) [m/A].
            modes: U, shape (n, n).
            generator: For what is left.
        """
        own = np.sum(self.slopes * error, axis=1)
        return self.response + modes @ (
            own + self.spread * generator.standard_normal(len(self.spread))
        )


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """Rows of the regression, of k coefficients: m correctors, the RF, the creep.

    Args:
        begun: Their mean before there was anything to learn from, shape (n, k).
        prior: Their covariance without anything to learn from, shape (k, k).
        rows: Their mean now, shape (n, k).
        covariances: Their covariance now, by level, shape (G, k, k).
        moved: The part of it that R has moved by since the rows that count, shape (k, k).
        levels: Level of every mode, shape (n,).
    """

    begun: Vector
    prior: Vector
    rows: Vector
    covariances: Vector
    moved: Vector
    levels: Indices


def find_column(
    told: KnownRf, modes: Vector, its: Belief, unit: float, error: float
) -> tuple[Vector, RfColumn]:
    """Find what all rows share, and with it the rows and the RF column.

    Args:
        told: What the places table says.
        modes: U, shape (n, n).
        its: What is known row by row.
        unit: Of a step of the RF in the regression [Hz].
        error: Stated error of the column told, relative to its rms [1].

    Returns:
        The rows, shape (n, k), and the column.
    """
    m, levels = len(told.energy), its.levels
    own = unit * (modes.T @ told.response)
    known = its.covariances - its.moved
    shared = np.zeros((len(its.prior), 2))
    shared[:m, 0], shared[m, 1] = 2.0 * told.energy / unit, 1.0
    weights = np.linalg.solve(its.prior, shared)
    seen = weights.T @ (its.prior - known) @ weights
    precision = np.eye(2) / error**2 + np.tensordot(own**2, seen[levels], axes=1)
    beta = np.linalg.solve(precision, own @ (its.rows - its.begun) @ weights)
    left = (known @ weights)[levels]
    rows = its.rows + own[:, None] * (left @ beta)
    response = modes @ rows[:, m] / unit
    power = float(own @ own)
    slope = own**2 @ left[:, m] / power
    single = float(own**2 @ known[levels, m, m]) / power**2
    drifted = its.moved[m, m] * len(own) / power
    across = its.covariances[:, :m, m]
    slopes = np.linalg.solve(its.covariances[:, :m, :m], across[:, :, None])[:, :, 0] / unit
    spread = its.covariances[:, m, m] / unit**2 - np.sum(slopes * across, axis=1) / unit
    return rows, RfColumn(
        told,
        response,
        ratio=float(response @ told.response) / float(told.response @ told.response),
        sigma=float(np.sqrt(slope @ np.linalg.solve(precision, slope) + single + drifted)),
        slopes=np.asarray(slopes[levels], dtype=np.float64),
        spread=np.sqrt(np.maximum(spread, 0.0))[levels],
    )

"""The RF column of the response: one more actuator, whose unit is Hz, beside the correctors.

A step h of the RF frequency that goes with a change a moves the orbit by R a + d h. So d is one
more column of R and h one more regressor, and R̂ and d̂ are one posterior. d begins as the
dispersion of the places table tells it, with an error that is stated (`rf_error`).

A table may be wrong in all places alike (momentum compaction, energy), or place by place:

    d_i = κ d0_i + e_i,   κ normal around 1, e_i normal around 0, either with the stated error.

Rows of UᵀR are independent in the regression, so that it knows of e alone. What the data say of
d_i is the posterior over its prior, a normal density; the κ that all rows share follows from these
in closed form, and d̂ from both.

Source: the normal hierarchical model, e.g. Gelman et al., Bayesian Data Analysis (2013), ch. 5.
"""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import KnownRf
from orbitfb.estimation.transform import Indices


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


def find_column(
    told: KnownRf,
    modes: Vector,
    begun: Vector,
    before: float,
    moved: float,
    mean: Vector,
    covariances: Vector,
    levels: Indices,
    unit: float,
    error: float,
) -> RfColumn:
    """Find the column and its ratio to the one told.

    Args:
        told: What the places table says; its column is d0.
        modes: U, shape (n, n).
        begun: Mean of Uᵀd in the regression before there are rows, shape (n,) [m per unit].
        before: Its variance [m² per unit²].
        moved: What d has moved by since the rows that count, in the covariances [m² per unit²].
        mean: The same when all rows are in, shape (n,).
        covariances: Of a row of UᵀR and of d behind it, by level, shape (G, m + 1, m + 1).
        levels: Level of every mode, shape (n,).
        unit: Of a step in the regression [Hz].
        error: Stated error of the column told, relative to its rms [1].
    """
    m = covariances.shape[1] - 1
    variance = covariances[levels, m, m] - moved
    known = np.maximum(1.0 / variance - 1.0 / before, 0.0)
    pull = mean / variance - begun / before
    own = unit * (modes.T @ told.response)
    local = error**2 * float(np.mean(own**2))
    seen = 1.0 / (1.0 + known * local)
    precision = 1.0 / error**2 + float(np.sum(own**2 * known * seen))
    share = (1.0 / error**2 + float(np.sum(own * pull * seen))) / precision
    found = (share * own + local * pull) * seen
    response = modes @ found / unit
    across = covariances[:, :m, m]
    slopes = np.linalg.solve(covariances[:, :m, :m], across[:, :, None])[:, :, 0] / unit
    left = covariances[:, m, m] / unit**2 - np.sum(slopes * across, axis=1) / unit
    return RfColumn(
        told,
        response,
        ratio=float(response @ told.response) / float(told.response @ told.response),
        sigma=_slope_sigma(own, seen, precision, local, moved),
        slopes=np.asarray(slopes[levels], dtype=np.float64),
        spread=np.sqrt(np.maximum(left, 0.0))[levels],
    )


def _slope_sigma(own: Vector, seen: Vector, precision: float, local: float, moved: float) -> float:
    """Standard deviation of the slope of d on d0: of κ, place by place, and of what has moved."""
    power = float(own @ own)
    shared = float(np.sum(own**2 * seen)) / power / np.sqrt(precision)
    single = float(np.sum(own**2 * local * seen)) / power**2
    return float(np.sqrt(shared**2 + single + moved / power * len(own)))

"""What the steps of the orbit are regressed on: changes, the step of the RF, and the creep."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.columns import Columns, KnownRf
from orbitfb.models.column import Belief, RfColumn, find_column
from orbitfb.models.rows import Rows


class Regressors(Columns):
    """The columns of the regression, correctors first, then the RF if it is one, then the creep.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        rf: What is known of the RF; None: it does not step.

    Attributes:
        modes: U, the left singular vectors of R̂, shape (n, n).
        first: What is known of R in modes, with a creep of zero, shape (n, actuators + 1).

    Raises:
        EstimationError: A matrix is not finite, is zero, or does not fit the other.
    """

    def __init__(self, response: Vector, rf: KnownRf | None) -> None:
        super().__init__(response, rf)
        self.modes = np.linalg.svd(response)[0]
        self.first = self.in_modes(response)

    def in_modes(self, response: Vector, column: Vector | None = None) -> Vector:
        """Give a response in modes, with a creep of zero, shape (n, actuators + 1).

        Args:
            response: R, shape (n, m) [m/A].
            column: d, shape (n,) [m/Hz]; None: the one that is known.
        """
        rows = self.modes.T @ self.whole(response, column)
        return np.column_stack([rows, np.zeros(len(rows))])

    @property
    def rf_place(self) -> int | None:
        """Which regressor is the step of the RF; None: none is."""
        return None if self.rf is None else self.correctors

    def of(self, rows: Rows) -> Vector:
        """Give the regressors of rows, shape (T, actuators + 1)."""
        columns = [rows.change]
        if self.rf is not None:
            hertz = np.zeros(len(rows)) if rows.hertz is None else rows.hertz
            columns.append(hertz[:, None] / self.unit)
        return np.column_stack([*columns, np.ones(len(rows))])

    def share(self, its: Belief, error: float) -> tuple[Vector, RfColumn | None]:
        """Find what the rows share, and the RF column; without the RF they share nothing.

        Args:
            its: What is known row by row.
            error: Stated error of the column told, relative to its rms [1].

        Returns:
            The rows, shape (n, k), and the column.
        """
        if self.rf is None:
            return its.rows, None
        return find_column(self.rf, self.modes, its, self.unit, error)

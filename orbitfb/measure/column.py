"""What is measured of one corrector, and the table of all of them."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from orbitfb.core.signals import Mask, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """One column of R.

    Args:
        response: Shape (n,) [m/A]; NaN at a BPM that was not valid.
        sigma: Its standard deviation, shape (n,) [m/A].
        noise: What the fit leaves over of an (averaged) orbit, rms [m].
        linearity: Part of the response that is not linear, rms over rms [1]; NaN: not known.
        following: Change of the readback per change of the setpoint [1]; NaN: not known.
        phase: Against that of all, where correctors moved at once [rad]; 0 by steps.
        amplitude: Largest step [A].
        time: When it was done [s since the epoch].
    """

    response: Vector
    sigma: Vector
    noise: float
    linearity: float
    following: float
    phase: float
    amplitude: float
    time: float


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Columns side by side, fields as those of `Column`; NaN where nothing was measured.

    Args:
        response: Shape (n, m) [m/A].
        sigma: Shape (n, m) [m/A].
        noise: Shape (m,) [m].
        linearity: Shape (m,) [1].
        following: Shape (m,) [1].
        phase: Shape (m,) [rad].
        amplitude: Shape (m,) [A].
        time: Shape (m,) [s since the epoch].
    """

    response: Vector
    sigma: Vector
    noise: Vector
    linearity: Vector
    following: Vector
    phase: Vector
    amplitude: Vector
    time: Vector

    @classmethod
    def empty(cls, bpms: int, correctors: int) -> "Table":
        """Give a table in which nothing was measured."""
        shapes = table_shapes(bpms, correctors)
        return cls(**{name: np.full(shape, np.nan) for name, shape in shapes.items()})

    @classmethod
    def of(cls, tensors: Mapping[str, Vector]) -> "Table":
        """Give a table of arrays by name."""
        return cls(**{field.name: tensors[field.name].copy() for field in fields(cls)})

    def tensors(self) -> dict[str, Vector]:
        """Give the arrays by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def measured(self) -> Mask:
        """Correctors that were measured, shape (m,)."""
        return np.isfinite(self.time)

    def put(self, corrector: int, column: Column) -> None:
        """Take what was measured of a corrector."""
        for field in fields(Column):
            getattr(self, field.name)[..., corrector] = getattr(column, field.name)


def table_shapes(bpms: int, correctors: int) -> dict[str, tuple[int, ...]]:
    """Give the shape of every array of a table by its name."""
    whole = ("response", "sigma")
    return {
        field.name: (bpms, correctors) if field.name in whole else (correctors,)
        for field in fields(Table)
    }

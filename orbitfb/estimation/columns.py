"""The columns of a response that an estimate begins with: correctors, and the RF as one more.

A step of the RF frequency is counted in a unit in which its column is as large as that of a
corrector is on average. So one relative prior and one relative drift hold for all columns.

The dispersion η of a table may be wrong by some share ε. It is in the column of the RF, and once
more in the correctors': at a fixed frequency a corrector changes the energy, which moves the orbit
by a pattern like that of the RF. In units of the frequency, w_j being the step that changes the
energy as an ampere of corrector j does, an error ε of η makes

    δd = ε d,   δR_ij = 2 ε d_i w_j.

A loop whose frequency follows changes both together, and could not tell them apart with a prior
that believes one of them more than the table deserves.
"""

from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Vector


@dataclass(frozen=True, slots=True, eq=False)
class KnownRf:
    """What is known of the RF as an actuator.

    Args:
        response: The RF column d, shape (n,) [m/Hz].
        energy: w, the step that changes the energy as an ampere of each corrector does, shape (m,)
            [Hz/A].
        identified: Whether the column was identified; else it is that of the places table.
    """

    response: Vector
    energy: Vector
    identified: bool = False


def check_first(response: Vector) -> None:
    """Refuse a response that nothing can begin with.

    Args:
        response: Shape (n, m).

    Raises:
        EstimationError: It is not a finite matrix that is not zero.
    """
    if response.ndim != 2 or not np.isfinite(response).all() or not np.any(response):
        raise EstimationError(
            f"the first response matrix (shape {response.shape}) must be a finite matrix "
            "that is not zero; compute or measure it again"
        )


class Columns:
    """The actuators of an estimate: correctors, and the RF behind them if it is one.

    Args:
        response: R̂ to begin with, shape (n, m) [m/A].
        rf: What is known of the RF; None: it does not step.

    Attributes:
        rf: As given.
        correctors: m.
        actuators: m, and one more with the RF.
        unit: In which a step of the RF is counted [Hz].

    Raises:
        EstimationError: A matrix is not finite, is zero, or does not fit the other.
    """

    def __init__(self, response: Vector, rf: KnownRf | None) -> None:
        check_first(response)
        self.rf, self.correctors = rf, response.shape[1]
        self.actuators, self.unit = self.correctors, 1.0
        if rf is None:
            return
        column, expected = rf.response, (response.shape[:1], response.shape[1:])
        fits = (column.shape, rf.energy.shape) == expected and np.isfinite(rf.energy).all()
        if not fits or not np.isfinite(column).all() or not np.any(column):
            raise EstimationError(
                f"an RF column of shape {column.shape} does not fit a response of shape "
                f"{response.shape}: it must be one finite number per BPM, and not zero; see "
                "eta_x_m of the places table"
            )
        size = np.linalg.norm(response) / np.sqrt(self.correctors)
        self.actuators, self.unit = self.correctors + 1, float(size / np.linalg.norm(column))

    def whole(self, response: Vector, column: Vector | None = None) -> Vector:
        """Give a response with its RF column, if that is one, shape (n, actuators).

        Args:
            response: R, shape (n, m) [m/A].
            column: d, shape (n,) [m/Hz]; None: the one that is known.
        """
        if self.rf is None:
            return response
        its = self.rf.response if column is None else column
        return np.column_stack([response, self.unit * its])

    @property
    def energy(self) -> Vector | None:
        """Energy per ampere in units of the regressor, shape (m,) [1/A]; None: no RF."""
        return None if self.rf is None else self.rf.energy / self.unit

    def prior(self, response: Vector, entry: float, relative: float, error: float) -> Vector:
        """Say how far a row of the whole response may be wrong, shape (actuators, actuators).

        Args:
            response: The whole response, shape (n, actuators).
            entry: Of an element of the correctors' columns, rms [m/A].
            relative: Of all columns, relative to the size of the response, rms [1].
            error: ε of the dispersion, rms [1].
        """
        m = self.correctors
        found = relative**2 * (response.T @ response) / len(response)
        found.flat[: m * len(found) : len(found) + 1] += entry**2
        if self.energy is not None:
            size = float(np.mean(response[:, m] ** 2))
            found[m, :m] = found[:m, m] = 0.0  # no step, no news of the column
            found[:m, :m] += (2.0 * error) ** 2 * size * np.outer(self.energy, self.energy)
            found[m, m] += error**2 * size
        return found

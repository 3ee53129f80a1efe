"""The baseline: correction through the singular value decomposition of the response matrix.

With R = U Σ Vᵀ (rows BPMs, columns correctors, [m/A]) the change of the setpoints is

    a = −gain · V diag(σ / (σ² + λ²)) Uᵀ e

over the first `singular_values` modes. The setpoints accumulate the changes, so this
proportional law leaves a constant error only behind a disturbance that keeps moving; the
integral term takes that away as well, and a little derivative quickens a loop whose changes
act late: P, PI and PID in mode space (`policies.pid`).

With a covariance P of the rows of R [(m/A)²] the law becomes *cautious*: it minimises the
expected square of the next orbit over what is not known about R,

    K = gain · (RᵀR + λ² I + n P)⁻¹ Rᵀ,

solved within the modes that are kept, so that P = 0 gives the law above exactly.

With a law for each plane (`policies.blocks`) each diagonal block of R is solved so by itself.

With weights w of the BPMs, W = diag(w) of mean square 1, it minimises |W (e + R a)|²: the law above
for W R and W e. A BPM of weight 0 has no say; λ and P keep their meaning.
"""

import numpy as np
from pydantic import Field, field_validator

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Mask, Vector
from orbitfb.policies.blocks import Plane, PlaneLaw, blocks_of, within
from orbitfb.policies.infill import NOISY, Infill
from orbitfb.policies.inverse import (
    checked_covariance,
    checked_response,
    content_hash,
    frozen,
    regularised_inverse,
)
from orbitfb.policies.pid import PidSettings, PidState, first_state, step

LARGEST_WEIGHT = 100.0
"""Largest weight of a BPM: another factor of 10 and rounding would lose modes of the others."""


class SvdSettings(PidSettings):
    """Configuration of the SVD policy."""

    regularisation: float = Field(
        default=70e-6, ge=0.0, description="Tikhonov λ, compared with the singular values [m/A]."
    )
    singular_values: int | None = Field(
        default=None,
        ge=1,
        description="Number of modes that are corrected [1]; unset: all of them.",
    )
    bpm_weights: tuple[float, ...] = Field(
        default=(),
        description=f"Weight of each BPM, 0 to {LARGEST_WEIGHT:g}, x first, then y, relative to "
        "the others [1]; empty: all the same.",
    )
    planes: dict[Plane, PlaneLaw] = Field(
        default={},
        description="Cut and λ of each plane by itself, tables `planes.x` and `planes.y`; none: "
        "one cut and one λ for the whole response.",
    )

    @field_validator("bpm_weights")
    @classmethod
    def _bounded(cls, weights: tuple[float, ...]) -> tuple[float, ...]:
        if not all(0.0 <= weight <= LARGEST_WEIGHT for weight in weights):
            raise ValueError(f"weights of BPMs are numbers from 0 to {LARGEST_WEIGHT:g}")
        return weights


class SvdPolicy:
    """Correct the orbit error through the (regularised) inverse of a response matrix.

    Masked BPMs read what the valid ones let expect (`policies.infill`). The tensors are copied and
    read-only, so a policy can be shared between threads.

    Args:
        response: R, shape (n, m) [m/A].
        settings: Gains and regularisation.
        policy_id: Its name; by default `svd-` and a hash of the content.
        covariance: Covariance P of every row of R, shape (m, m) [(m/A)²]; None: R is exact.

    Attributes:
        response: R, shape (n, m) [m/A].
        covariance: P, shape (m, m) [(m/A)²], or None.
        settings: Gains and regularisation.
        bpm_weights: Of mean square 1, shape (n,) [1], or None.
        gain_matrix: K, shape (m, n) [A/m]: the proportional law is a = −K e.
        solved: R as the law sees it: weighted, and without what one plane does in the other,
            shape (n, m) [m/A].
        damping: λ of each corrector, shape (m,) [m/A].

    Raises:
        RingError: A matrix is not finite or has the wrong shape.
        ConfigError: More singular values are asked for than there are, or the weights are not
            one for each BPM.
    """

    def __init__(
        self,
        response: Vector,
        settings: SvdSettings,
        policy_id: str | None = None,
        covariance: Vector | None = None,
    ) -> None:
        self.response = checked_response(response)
        columns = self.response.shape[1]
        self.covariance = None if covariance is None else checked_covariance(covariance, columns)
        self.settings = settings
        self._blocks = blocks_of(
            settings.planes,
            self.response.shape,
            settings.singular_values,
            settings.regularisation,
        )
        self.bpm_weights = _weights(settings.bpm_weights, len(self.response))
        weights = 1.0 if self.bpm_weights is None else self.bpm_weights[:, None]
        self.solved = frozen(within(self._blocks, weights * self.response))
        self.damping = np.concatenate(
            [
                np.full(its.columns.stop - its.columns.start, its.regularisation)
                for its in self._blocks
            ]
        )
        # The names of old laws stay.
        unset = [key for key in ("bpm_weights", "planes") if not getattr(settings, key)]
        self._policy_id = policy_id or "svd-" + content_hash(
            settings, self.response, self.covariance, exclude=unset
        )
        self.gain_matrix = self._solve()
        self._memoryless = settings.is_memoryless
        self._infill = Infill(within(self._blocks, self.response), NOISY)

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it."""
        return self._policy_id

    def initial_state(self) -> PidState:
        """Begin without an integral and without a derivative."""
        return first_state(self.response.shape[1])

    def act(self, error: Vector, valid: Mask, state: PidState) -> tuple[Vector, PidState]:
        """Decide.

        Integral and derivative are kept at the correctors and not in the modes: all modes have
        one gain, so it is the same sum, and it keeps its meaning when a mask changes the modes.
        A caller whose change was shortened or not written hands the old state in again and
        nothing winds up (`policies.pid`).

        A mask that is new costs some milliseconds for 180 by 180 (`policies.infill`).

        Args:
            error: Orbit − reference, shape (n,) [m]; elements that are not valid are ignored.
            valid: BPMs that count, shape (n,).
            state: What the last call returned, or `initial_state()`.

        Returns:
            The change of setpoints, shape (m,) [A], and the new state.
        """
        if valid.all():
            proportional = self.gain_matrix @ error
        else:
            filled = self._infill.fill(error, valid)
            proportional = self._infill.least(self.gain_matrix @ filled, valid)
        if self._memoryless:
            return -proportional, state
        correction = proportional / self.settings.gain
        return step(self.settings, correction, valid.tobytes(), state)

    def changes(self, errors: Vector) -> Vector:
        """Decide on many orbits at once, all BPMs valid.

        Args:
            errors: Orbit − reference, shape (..., n) [m].

        Returns:
            The changes of setpoints, shape (..., m) [A].

        Raises:
            ConfigError: With an integral or a derivative, changes depend on earlier orbits.
        """
        if not self._memoryless:
            raise ConfigError(
                f"policy {self._policy_id} has integral_gain {self.settings.integral_gain:g} and "
                f"derivative_gain {self.settings.derivative_gain:g}, so its changes depend on "
                "earlier orbits; ask act tick by tick, or set both to 0"
            )
        return -(errors @ self.gain_matrix.T)

    def _solve(self) -> Vector:
        """Solve the law, K, shape (m, n), block by block."""
        gains = np.zeros(self.response.shape[::-1])
        for block in self._blocks:
            rows, columns = block.rows, block.columns
            gains[columns, rows] = regularised_inverse(
                self.solved[rows, columns],
                block.regularisation,
                None if self.covariance is None else self.covariance[columns, columns],
                block.singular_values,
            )
        weights = 1.0 if self.bpm_weights is None else self.bpm_weights
        return frozen(self.settings.gain * (gains * weights))


def _weights(given: tuple[float, ...], rows: int) -> Vector | None:
    """Scale weights to a mean square of 1, shape (rows,); None: all the same."""
    if not given:
        return None
    weights = np.array(given, dtype=np.float64)
    if len(weights) != rows or not weights.any():
        raise ConfigError(
            f"bpm_weights has {len(weights)} numbers, {np.count_nonzero(weights)} of them not 0; "
            f"give one for each of {rows} BPMs, x first, then y, at least one above 0"
        )
    return frozen(weights / np.sqrt(np.mean(weights**2)))

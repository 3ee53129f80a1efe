"""How well beliefs about R predict rows: sums over an unbroken tail of rows.

In the sine transform of the tail (`orbitfb.estimation.transform`) what a belief does not explain
has the variance V_f = r² (ρ_i + λ_f) of noise and ground, and φ_fᵀ P φ_f of what is not known about
R. Sums of squares over V_f, and of φ_fᵀ P φ_f over V_f, are sums over rows of innovations: the
difference of those over a tail with its new rows and without them is about the new rows alone,
given those before, also where R̂ was fitted to the rows before. Nothing is used before it is
predicted. What is not known of R comes in after that difference, as one factor for the new rows:
weighed frequency by frequency it would let the rows before, which fit R̂ too well, speak again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.estimation.statistics import StepPosterior, StepSpectrum
from orbitfb.models.filter import ground_ratio, innovation_ratio
from orbitfb.models.noise import LADDER, NoiseEstimate

_RATIOS = ground_ratio(LADDER)


@dataclass(frozen=True, slots=True)
class Sums:
    """Sums over rows; differences of them are about the rows between.

    Args:
        misfits: Σ z²/V over rows and modes under every belief, shape (beliefs,).
        doubts: Σ φᵀPφ/V over rows and modes, P of every belief, shape (beliefs,).
        chi2: Σ z²/(V + φᵀPφ) of the chosen belief over rows, mean over modes.
        chi2_other: Σ z²/V of the other response, mean over modes.
        gain: Half of Σ z²/V of the other response less that of the chosen belief, the creep taken
            out of both [nats].
        doubt: Σ φᵀPφ/V of the chosen belief, the creep taken for known.
        squares: Squares of innovations for every level and mode, shape (levels, n) [m²].
        counted: Rows that count in `squares`.
    """

    misfits: Vector
    doubts: Vector
    chi2: float
    chi2_other: float
    gain: float
    doubt: float
    squares: Vector
    counted: float

    def __sub__(self, before: "Sums") -> "Sums":
        names = [field.name for field in fields(Sums)]
        return Sums(*(getattr(self, name) - getattr(before, name) for name in names))

    def densities(self, rows: int) -> Vector:
        """Log density of rows under every belief but for what all have in common, (beliefs,)."""
        count = rows * self.squares.shape[1]
        wider = 1.0 + np.maximum(self.doubts, 0.0) / count
        return -0.5 * (self.misfits / wider + count * np.log(wider))

    def nats(self, rows: int) -> float:
        """Log density of rows under the chosen belief over that under the other response.

        Both have the variance that noise and doubt about R predict.
        """
        return self.gain / (1.0 + max(self.doubt, 0.0) / (rows * self.squares.shape[1]))


def no_sums(modes: int, beliefs: int) -> Sums:
    """Sums over no row."""
    none = np.zeros(beliefs)
    return Sums(none, none, 0.0, 0.0, 0.0, 0.0, np.zeros((len(LADDER), modes)), 0.0)


def sums_of(
    spectrum: StepSpectrum,
    beliefs: Sequence[StepPosterior],
    chosen: int,
    other: Vector,
    noise: NoiseEstimate,
    kick_chi2: float,
) -> Sums:
    """Sum up what rows say.

    Args:
        spectrum: Of the tail, the steps being what R̂₀ does not explain.
        beliefs: About R − R̂₀.
        chosen: Which of them is believed.
        other: Rows of Uᵀ(R − R̂₀) of another response, shape (n, m + 1) [m/A].
        noise: As estimated from earlier rows.
        kick_chi2: χ² above which a frequency does not teach the noise.
    """
    member = np.eye(len(LADDER))[noise.levels]
    count, modes = member.sum(axis=0), len(noise.levels)
    plain = noise.reading_variance * (_RATIOS + spectrum.eigenvalue[:, None])
    constant = spectrum.regressors[:, -1]
    certainty = (1.0 / plain) @ count
    misfits, doubts = np.empty((2, len(beliefs)))
    own, variance, doubt = np.empty(0), plain, np.empty(0)
    for index, belief in enumerate(beliefs):
        pooled = np.tensordot(count / modes, belief.covariances, axes=1)
        seen = spectrum.regressors @ pooled
        unknown = np.sum(seen * spectrum.regressors, axis=1)
        residual = spectrum.steps - spectrum.regressors @ belief.rows.T
        misfits[index] = float(np.sum(residual**2 @ member / plain))
        doubts[index] = float(unknown @ certainty)
        if index == chosen:
            own, variance = residual, plain + unknown[:, None]
            # The prior of the creep is wide: where nothing creeps it would explain noise.
            doubt = unknown - 2.0 * seen[:, -1] * constant + constant**2 * pooled[-1, -1]
    theirs = spectrum.steps - spectrum.regressors @ other.T
    squared = own**2
    chi2 = np.sum(squared @ member / variance, axis=1) / modes
    certain = plain / (plain + np.maximum(doubt, 0.0)[:, None])
    known = (certain @ count / modes > 0.5) & (chi2 < kick_chi2)
    weights = known / (_RATIOS[:, None] + spectrum.eigenvalue)
    spread = innovation_ratio(LADDER)[:, None]
    return Sums(
        misfits,
        doubts,
        chi2=float(chi2.sum()),
        chi2_other=float(np.sum(theirs**2 @ member / plain)) / modes,
        gain=0.5
        * (
            _without_creep(theirs, constant, plain, member)
            - _without_creep(own, constant, plain, member)
        ),
        doubt=float(doubt @ certainty),
        squares=spread * (weights @ (squared * certain[:, noise.levels])),
        counted=float(known.sum()),
    )


def _without_creep(residual: Vector, constant: Vector, variance: Vector, member: Vector) -> float:
    """Σ z²/V once a creep of its own is taken out of every mode.

    Args:
        residual: z, shape (T, n) [m].
        constant: What a creep makes, shape (T,).
        variance: V of every level, shape (T, levels) [m²].
        member: Whether a mode is of a level, shape (n, levels).
    """
    weighted = constant[:, None] / variance
    pull = np.sum((residual.T @ weighted) * member, axis=1)
    information = member @ (constant @ weighted)
    return float(np.sum(residual**2 @ member / variance) - np.sum(pull**2 / information))

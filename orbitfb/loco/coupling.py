"""The fit of the cross blocks: rolls of readings, tilts of correctors, skew gradients.

    M_ij = ρ_i (orbit of the other plane at BPM i) + (1 + g_i) [G'_ij τ_j + Σ_q G'_iq s_q G'_qj k_j]

ρ is what a reading sees of the other plane, τ the kick of a corrector into the plane that is read,
s the skew gradients of quadrupoles and sextupoles; gains g, kicks k and optics G' are those of the
fit in the planes. To first order in coupling, which is some per cent.
"""

from dataclasses import dataclass, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.loco.measured import CROSS, Measured, Pair
from orbitfb.loco.noise import separable, spreads
from orbitfb.loco.normal import Piece, normal_equations
from orbitfb.loco.optics import RingOptics
from orbitfb.loco.parameters import MOST_NOISE, OUTLIER, STANDS_OUT, Fit, Groups, Noise
from orbitfb.loco.posterior import WIDE, Posterior, evidence_spread, posterior, robust_spread
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane

_FIRST = {"roll": 0.02, "tilt": 0.02, "skew": 0.003}
"""Spreads with which the fit begins [rad, rad, 1/m]."""
_LEAST = {"roll": 1e-4, "tilt": 1e-4, "skew": 1e-6}
_ROUNDS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """The fitted cross blocks.

    Args:
        groups: Where the parameters stand: `roll:x` is what a reading of x sees of y, `tilt:x`
            what a corrector of x kicks in y, `skew` [1/m].
        posterior: Values and uncertainty.
        free: Parameters that stand out, shape (k,).
        spread: Healthy spread of every group.
        noise: Of every block.
        residual: Measured less model, of every block [m/rad].
        model: Fitted blocks [m/rad].
    """

    groups: Groups
    posterior: Posterior
    free: Mask
    spread: dict[str, float]
    noise: dict[Pair, Noise]
    residual: dict[Pair, Matrix]
    model: dict[Pair, Matrix]

    def part(self, name: str) -> Vector:
        """Values of a group."""
        return self.posterior.mean[self.groups.of[name]]


def fit_coupling(optics: RingOptics, measured: Measured, fit: Fit) -> Coupling | None:
    """Fit the cross blocks; None where none was measured, or a plane was not fitted.

    Args:
        optics: The ring at the devices of the measurement.
        measured: The measurement.
        fit: Of its planes.
    """
    pairs = tuple(
        pair
        for pair in CROSS
        if pair in measured.response and np.isfinite(measured.response[pair]).any()
    )
    if not pairs or len(measured.planes) < 2:
        return None
    groups = _groups(measured, len(optics.skews))
    spread = {name: _FIRST[name.split(":")[0]] for name in groups.of}
    theta, free = np.zeros(groups.size), np.zeros(groups.size, dtype=np.bool_)
    bare = {pair: _piece(optics, measured, fit, groups, pair) for pair in pairs}
    noise: dict[Pair, Noise] = {}
    matrix, pull = np.eye(groups.size), np.zeros(groups.size)
    for number in range(_ROUNDS):
        # before anything is fitted a turned BPM is far off in all of its row: none is an outlier
        noise = {
            pair: _noise(
                measured, pair, bare[pair].residual - _model(bare[pair], theta), number > 0
            )
            for pair in pairs
        }
        pieces = [
            replace(
                piece,
                kept=noise[pair].kept,
                row_weight=noise[pair].rows ** -2.0,
                column_weight=noise[pair].columns ** -2.0,
            )
            for pair, piece in bare.items()
        ]
        matrix, pull = normal_equations(pieces, groups.size)
        its = posterior(matrix, pull, _prior(groups, spread, free))
        for name, index in groups.of.items():
            kind = name.split(":")[0]
            spread[name] = (
                evidence_spread(its, index[~free[index]], _LEAST[kind])
                if kind == "skew"
                else robust_spread(its, index, _LEAST[kind])
            )
        free = _standing(groups, its, spread, free)
        theta = its.mean
    its = posterior(matrix, pull, _prior(groups, spread, free))
    models = {pair: _model(bare[pair], its.mean) for pair in pairs}
    residual = {pair: bare[pair].residual - models[pair] for pair in pairs}
    return Coupling(groups, its, free, spread, noise, residual, models)


def _groups(measured: Measured, skews: int) -> Groups:
    of, begin = {}, 0
    for name, count in (
        ("roll:x", len(measured.bpms["x"])),
        ("roll:y", len(measured.bpms["y"])),
        ("tilt:x", len(measured.correctors["x"])),
        ("tilt:y", len(measured.correctors["y"])),
        ("skew", skews),
    ):
        of[name] = np.arange(begin, begin + count)
        begin += count
    return Groups(begin, of)


def _piece(optics: RingOptics, measured: Measured, fit: Fit, groups: Groups, pair: Pair) -> Piece:
    read, driven = pair
    gradients, here = fit.part("gradient"), fit.optics[read]
    left, _ = optics.at_skews(read, gradients, here)
    _, right = optics.at_skews(driven, gradients, fit.optics[driven])
    gain = 1.0 + fit.part(f"gain:{read}")
    kick = 1.0 + fit.part(f"scale:{driven}") + fit.part(f"calibration:{driven}")
    data = measured.response[pair]
    return Piece(
        np.where(np.isfinite(data), data, 0.0),
        np.isfinite(data),
        np.ones(len(gain)),
        np.ones(len(kick)),
        [(_seen(measured, fit, read, driven), groups.of[f"roll:{read}"])],
        [(gain[:, None] * here.other, groups.of[f"tilt:{driven}"])],
        gain[:, None] * left,
        right * kick,
        groups.of["skew"],
    )


def _seen(measured: Measured, fit: Fit, read: Plane, driven: Plane) -> Matrix:
    """Orbit of the driven plane at the BPMs of the other; zero at those it does not have."""
    orbit = fit.model[driven] / (1.0 + fit.part(f"gain:{driven}"))[:, None]
    where = {int(place): row for row, place in enumerate(measured.bpms[driven])}
    found = np.zeros((len(measured.bpms[read]), orbit.shape[1]))
    for row, place in enumerate(measured.bpms[read]):
        if int(place) in where:
            found[row] = orbit[where[int(place)]]
    return found


def _model(piece: Piece, theta: Vector) -> Matrix:
    (seen, rolls), (kicked, tilts) = piece.rows[0], piece.columns[0]
    return (
        seen * theta[rolls][:, None]
        + kicked * theta[tilts]
        + (piece.left * theta[piece.gradients]) @ piece.right
    )


def _noise(measured: Measured, pair: Pair, residual: Matrix, cut: bool) -> Noise:
    """Estimate the noise of a block; `cut`: whether elements far off count as outliers."""
    there = np.isfinite(measured.response[pair])
    s, t = spreads(residual, there)
    s = np.minimum(s, MOST_NOISE * np.nanmedian(s))
    t = np.clip(t, 1 / MOST_NOISE, MOST_NOISE)
    known, columns = separable(measured.sigma[pair])
    if np.isfinite(known).any():
        t = np.where(np.isfinite(columns), np.maximum(t, columns), t)
        s = np.where(np.isfinite(known), np.maximum(s, known), s)
    outliers = there & cut & (np.abs(residual) > OUTLIER * np.outer(s, t))
    return Noise(np.nan_to_num(s, nan=1.0), np.nan_to_num(t, nan=1.0), there & ~outliers, outliers)


def _prior(groups: Groups, spread: dict[str, float], free: Mask) -> Vector:
    prior = np.empty(groups.size)
    for name, index in groups.of.items():
        prior[index] = spread[name] ** 2
    prior[free] = WIDE
    return prior


def _standing(groups: Groups, its: Posterior, spread: dict[str, float], free: Mask) -> Mask:
    found = np.zeros(groups.size, dtype=np.bool_)
    for name, index in groups.of.items():
        z = its.standing(index, spread[name], False)
        if name == "skew":  # one at a time: neighbours share what one of them does
            found[index] = free[index] & (z > STANDS_OUT)
            if len(z) and z.max() > STANDS_OUT:
                found[index[int(np.argmax(z))]] = True
        else:
            found[index] = z > STANDS_OUT
    return found

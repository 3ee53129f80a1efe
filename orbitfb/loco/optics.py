"""The optics of a ring whose quadrupoles are not quite those of the table, rebuilt at every step.

Thin quadrupoles, exact in their strengths: with K = diag(∓Δk) and Green's functions G of the table

    G'_qc = (1 − G_qq K)⁻¹ G_qc     G'_bq = G_bq (1 − K G_qq)⁻¹     G'_bc = G_bc + G_bq K G'_qc

and ∂G'_bc / ∂(∓Δk_q) = G'_bq[:, q] G'_qc[q, :], which is all that a Gauss-Newton step needs.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from orbitfb.core.errors import RingError
from orbitfb.core.signals import Vector
from orbitfb.loco.measured import Measured
from orbitfb.physics.optics import Matrix, green
from orbitfb.physics.places import Indices, Plane, Ring, plane_row

SIGN: Mapping[Plane, float] = {"x": -1.0, "y": 1.0}
"""An orbit z in a gradient that is Δk too strong is kicked by SIGN · Δk · z."""


@dataclass(frozen=True, slots=True, eq=False)
class PlaneOptics:
    """Green's functions of one plane with gradient errors.

    Args:
        own: BPMs by the correctors of this plane, shape (n, m) [m/rad].
        other: BPMs by the correctors of the other plane, as if they kicked here [m/rad].
        left: BPMs by quadrupoles, shape (n, q) [m/rad].
        right: Quadrupoles by the correctors of this plane, shape (q, m) [m/rad].
        dispersion: At the BPMs, shape (n,) [m]; zero in y.
        at_quadrupoles: Dispersion in the quadrupoles, shape (q,) [m].
        left_momentum: `left` at fixed momentum [m/rad].
        turned_rows: Change of `own` by the betatron phase of the BPM, shape (n, m) [m/rad²].
        turned_columns: The same by the phase of the corrector, shape (n, m) [m/rad²].
    """

    own: Matrix
    other: Matrix
    left: Matrix
    right: Matrix
    dispersion: Vector
    at_quadrupoles: Vector
    left_momentum: Matrix
    turned_rows: Matrix
    turned_columns: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class _Design:
    bc: Matrix
    bq: Matrix
    qc: Matrix
    qq: Matrix
    b: Vector
    q: Vector
    columns: int
    turned_bc: Matrix
    turned_bq: Matrix
    turned_qc: Matrix


class RingOptics:
    """Responses of a ring at the devices of a measurement, for any gradient errors.

    Args:
        ring: The ring.
        measured: Whose BPMs and correctors count.
        model: Response of every plane by another program, shape (n, m) [m/rad], in place of that of
            the table, which still says what gradients change; NaN: as the table says; None: all.
    """

    def __init__(
        self, ring: Ring, measured: Measured, model: Mapping[Plane, Matrix] | None = None
    ) -> None:
        self.quadrupoles = ring.places("QUAD")
        self.skews = np.concatenate([self.quadrupoles, ring.places("SEXT")])
        self._devices = {p: (measured.bpms[p], measured.correctors[p]) for p in measured.planes}
        strength = ring.strength("QUAD")
        usual = float(np.median(np.abs(strength))) if len(strength) else 1.0
        self.strength = np.where(strength == 0.0, usual or 1.0, strength)
        self._stretch = ring.parameters.alpha_c * ring.parameters.circumference
        self._design: dict[Plane, _Design] = {}
        for plane in measured.planes:
            own = measured.correctors[plane]
            other = measured.correctors.get("y" if plane == "x" else "x", own[:0])
            sources = np.concatenate([own, other])
            bpms, quadrupoles = measured.bpms[plane], self.quadrupoles
            eta = ring.table.dispersion if plane == "x" else np.zeros_like(ring.table.dispersion)
            response = green(ring, bpms, sources, plane)
            if model is not None and plane in model:
                its = model[plane]
                response[:, : len(own)] = np.where(np.isfinite(its), its, response[:, : len(own)])
            self._design[plane] = _Design(
                response,
                green(ring, bpms, quadrupoles, plane),
                green(ring, quadrupoles, sources, plane),
                green(ring, quadrupoles, quadrupoles, plane),
                eta[bpms],
                eta[quadrupoles],
                len(own),
                turned(ring, bpms, own, plane),
                turned(ring, bpms, quadrupoles, plane),
                turned(ring, own, quadrupoles, plane).T,
            )
        self.tunes = {plane: ring.tune(plane) for plane in measured.planes}
        self.ring = ring

    def at(self, relative: Vector) -> dict[Plane, PlaneOptics]:
        """Give the optics with gradient errors.

        Args:
            relative: ΔK/K of every quadrupole, shape (q,) [1].

        Raises:
            RingError: They leave no closed orbit.
        """
        return {plane: self._plane(plane, relative) for plane in self._design}

    def _plane(self, plane: Plane, relative: Vector) -> PlaneOptics:
        its = self._design[plane]
        kick = SIGN[plane] * self.strength * relative
        try:
            # (1 − K G_qq) = (1 − G_qq K)ᵀ because G_qq is symmetric: one inverse for both
            inverse = np.linalg.inv(np.eye(len(kick)) - its.qq * kick)
        except np.linalg.LinAlgError as error:
            raise RingError(
                "the gradient errors put the ring on an integer resonance, where no closed orbit "
                "exists; is the table of places of this ring and of its working point?"
            ) from error
        right = inverse @ its.qc
        whole = its.bc + (its.bq * kick) @ right
        left = its.bq @ inverse.T
        own, other = whole[:, : its.columns], whole[:, its.columns :]
        right = right[:, : its.columns]
        rows = its.turned_bc + (its.turned_bq * kick) @ right
        columns = -its.turned_bc + (left * kick) @ its.turned_qc
        if plane == "y":
            return PlaneOptics(own, other, left, right, its.b, its.q, left, rows, columns)
        design = its.bq + np.outer(its.b, its.q) / self._stretch
        loop = np.eye(len(kick)) - (its.qq + np.outer(its.q, its.q) / self._stretch) * kick
        there = np.linalg.inv(loop)
        eta_q = there @ its.q
        eta_b = its.b + (design * kick) @ eta_q
        return PlaneOptics(own, other, left, right, eta_b, eta_q, design @ there.T, rows, columns)

    def at_skews(self, plane: Plane, relative: Vector, its: PlaneOptics) -> tuple[Matrix, Matrix]:
        """Orbit at the BPMs by kicks where planes couple, and orbit there by the correctors.

        Planes couple in rolled quadrupoles, and in sextupoles: the beam is off their middle, or
        they have skew windings.

        Args:
            plane: `x` or `y`.
            relative: ΔK/K of every quadrupole, shape (q,) [1].
            its: The optics with these errors.

        Returns:
            Shapes (n, k) and (k, m) [m/rad], of quadrupoles and then sextupoles.
        """
        bpms, correctors = self._devices[plane]
        kick = SIGN[plane] * self.strength * relative
        there = green(self.ring, self.quadrupoles, self.skews, plane)
        left = green(self.ring, bpms, self.skews, plane) + (its.left * kick) @ there
        right = green(self.ring, self.skews, correctors, plane) + (there.T * kick) @ its.right
        return left, right

    def tune(self, plane: Plane, relative: Vector) -> float:
        """Betatron tune with gradient errors, by the trace of the one-turn matrix.

        Thin errors multiply the one-turn matrix; seen from between two places its trace is
        2 cos 2πν. The integer part stays, as errors do not lead over a resonance.

        Args:
            plane: `x` or `y`.
            relative: ΔK/K of every quadrupole, shape (q,) [1].
        """
        table, row = self.ring.table, 0 if plane == "x" else 1
        beta = table.beta[row, self.quadrupoles]
        phase = table.phase[row, self.quadrupoles]
        nominal = self.ring.tune(plane)
        kick = SIGN[plane] * self.strength * relative
        steps = np.diff(np.append(phase, phase[0] + 2 * np.pi * nominal)) if len(phase) else []
        turn = np.eye(2)
        for size, step in zip(kick * beta, steps, strict=True):
            cos, sin = np.cos(step), np.sin(step)
            turn = np.array([[cos, sin], [-sin, cos]]) @ np.array([[1.0, 0.0], [size, 1.0]]) @ turn
        if not len(kick):
            return nominal
        fraction = float(np.arccos(np.clip(np.trace(turn) / 2.0, -1.0, 1.0)) / (2 * np.pi))
        whole = np.floor(nominal)
        return float(whole + (fraction if nominal - whole < 0.5 else 1.0 - fraction))

    def beta_beat(self, plane: Plane, relative: Vector, places: np.ndarray) -> Vector:
        """Δβ/β at places, exact for thin errors, from the response of a place to itself.

        G(i, i) = β / (2 tan πν) at fixed momentum, so β' follows from G' and the new tune.

        Args:
            plane: `x` or `y`.
            relative: ΔK/K of every quadrupole, shape (q,) [1].
            places: Places in the table, shape (n,).

        Returns:
            Shape (n,) [1].
        """
        ring, row = self.ring, 0 if plane == "x" else 1
        eta = ring.table.dispersion / np.sqrt(abs(self._stretch)) * (1.0 if plane == "x" else 0.0)
        sign = np.sign(self._stretch)

        def at_fixed_momentum(rows: np.ndarray, columns: np.ndarray) -> Matrix:
            return green(ring, rows, columns, plane) + sign * np.outer(eta[rows], eta[columns])

        kick = SIGN[plane] * self.strength * relative
        loop = np.eye(len(kick)) - at_fixed_momentum(self.quadrupoles, self.quadrupoles) * kick
        there = np.linalg.solve(loop, at_fixed_momentum(self.quadrupoles, places))
        back = at_fixed_momentum(places, self.quadrupoles) * kick
        beta = ring.table.beta[row, places]
        own = beta / (2 * np.tan(np.pi * ring.tune(plane))) + np.einsum("iq,qi->i", back, there)
        return own * 2 * np.tan(np.pi * self.tune(plane, relative)) / beta - 1.0


def turned(ring: Ring, observers: Indices, sources: Indices, plane: Plane) -> Matrix:
    """Change of the response by the betatron phase of the observers, ∂G(i, j)/∂φ_i [m/rad²].

    By the phase of the sources it is the same with the opposite sign.

    Args:
        ring: The ring.
        observers: n places.
        sources: m places.
        plane: `x` or `y`.
    """
    row, half_turn = plane_row(plane), np.pi * ring.tune(plane)
    root_beta, phase = np.sqrt(ring.table.beta[row]), ring.table.phase[row]
    distance = phase[observers, None] - phase[None, sources]
    amplitude = root_beta[observers, None] * root_beta[None, sources] / (2 * np.sin(half_turn))
    return -amplitude * np.sign(distance) * np.sin(np.abs(distance) - half_turn)

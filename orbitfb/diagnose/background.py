"""What no model has right: gains of one per cent, gradients that beat by one or two.

A nominal response is never exact. Errors of all the gains and gradients at once, each normal and
small, are part of the noise as long as nothing needs a larger one: their effect on the orbit is a
linear regression with a prior, whose best values are taken out of every record. What is left is
judged. A cause has to be larger than this prior (LOCO's fitted parameters of healthy rings scatter
by as much: J. Safranek, Nucl. Instrum. Meth. A 388 (1997)).
"""

import copy
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.bent import Bent
from orbitfb.diagnose.healing import Errors, Preconditioner, Single
from orbitfb.diagnose.innovation import NoiseFloor
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import plane_row
from orbitfb.records.layout import ChannelPlane, Layout

GAIN_RMS = 0.01
"""Scatter of the gains of BPMs and correctors that is taken as healthy [1]."""
BEAT_RMS = 0.015
"""Beta-beat of gradient errors that is taken as healthy, rms over both planes [1]."""

TUNE_RMS = 0.003
"""By how much a tune may be off: it is measured, and quadrupoles are trimmed until it is right."""

OPTICS_RMS = 0.025
"""What healthy gradients do to the orbit that is steered, as a share of it [1]: so much on the
default ring by errors of `BEAT_RMS`."""

Healthy = Literal["correctors", "bpms", "x", "y"]
"""What has small errors: gains of correctors, of BPMs, gradients as seen in a plane."""

_MOST_ERRORS = 1000
"""Errors of a response whose optics are not known, of a plane."""
_LEAST = 1e-3
"""Share of the largest one below which none of them is seen."""

_LEVELS = 14
"""Of the ladder of filters: what is wrong in the information stays in the best sizes."""


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """P small errors: orbit = Σ size · pattern · driver, drivers = (currents, orbit) · weights.

    Args:
        name: What has them.
        patterns: Shape (n, P).
        weights: Shape (m + n, P).
        scatter: Standard deviation of every size, shape (P,).
        held: What sizes of one scatter change in units of its tolerance, a sum that is known to be
            nothing, shape (P,); None where there is none.
    """

    name: Healthy | Literal["response of a ring that is not known"]
    patterns: Matrix
    weights: Matrix
    scatter: Vector
    held: Vector | None = None


class Background:
    """Small errors of every gain and gradient, and how a record bears on them.

    Args:
        layout: Devices and model.
        currents: That act on the beam, shape (N, m) [A].
        orbit: Predicted orbit at the BPMs, shape (N, n) [m].
        starts: Where stretches begin, shape (N,).
        scale: Of the healthy scatter; 0 for a model that is taken as exact.
    """

    def __init__(
        self, layout: Layout, currents: Matrix, orbit: Matrix, starts: Mask, scale: float = 1.0
    ) -> None:
        self._starts = starts
        self._scale = scale
        n, m = layout.response.shape
        gain = GAIN_RMS * scale
        bent = Bent(layout)
        self._parts = [
            _Part("correctors", bent.response, np.eye(m + n, m), np.full(m, gain)),
            _Part("bpms", np.eye(n), np.eye(m + n, n, -m), np.full(n, gain)),
        ]
        if layout.ring is not None and len(layout.ring.places("QUAD")):
            gradients = _gradient_scatters(layout)
            for plane in layout.planes:
                to_bpms = bent.orbit_per_kick(plane)
                at_quads = np.pad(bent.orbit_at(plane).T, ((0, n), (0, 0)))
                scatter = scale * layout.restless * gradients
                held = _tune_changes(layout, plane) * scatter / TUNE_RMS
                self._parts.append(_Part(plane, to_bpms, at_quads, scatter, held))
        elif m:
            self._parts += [
                _response_errors(layout, plane, currents, OPTICS_RMS * scale)
                for plane in layout.planes
            ]
        self._errors = self._acting(currents, orbit)
        self._held = self._sums()
        self._solver: Preconditioner | None = None

    def elsewhere(self, currents: Matrix, orbit: Matrix, starts: Mask) -> "Background":
        """The very same errors in another record; which they are may depend on the record.

        Args:
            currents: That act on the beam there, shape (N, m) [A].
            orbit: Predicted orbit at the BPMs, shape (N, n) [m].
            starts: Where stretches begin, shape (N,).
        """
        other = copy.copy(self)
        other._starts, other._solver = starts, None
        other._errors = other._acting(currents, orbit)
        return other

    def _acting(self, currents: Matrix, orbit: Matrix) -> Errors:
        """All parts with what drives them; single precision is enough for errors of a per cent."""
        patterns = np.concatenate([p.patterns for p in self._parts], axis=1)
        weights = np.concatenate([p.weights * p.scatter for p in self._parts], axis=1)
        courses = np.hstack([currents, orbit])
        return Errors(patterns, courses - courses.mean(axis=0), weights)

    def prepare(self, floor: NoiseFloor, levels: int = _LEVELS) -> None:
        """Compute the information of the record on all sizes, once for a floor.

        Args:
            floor: The noise.
            levels: Of the ladder of filters; a few do to find the sizes by, in more steps.
        """
        if self._scale:
            held = self._held
            self._solver = Preconditioner(self._errors, floor, self._starts, levels, held)

    @property
    def log_volume(self) -> float:
        """Log of the share of the prior that the record leaves open, ½ log |Q| / |J + Q| [nats].

        What the likelihood at the most likely sizes has to be multiplied with to be that of
        the scatter they have.
        """
        return 0.0 if self._solver is None else self._solver.log_volume

    def absorbed(self, name: Healthy) -> Vector:
        """Share of the information on an error that the background takes away, shape (P,).

        What acts like an error of one device can be told from the healthy errors of all of them
        only as far as this leaves.

        Args:
            name: Gains of `correctors` or `bpms`; gradients of the quadrupoles as seen in `x`, `y`.
        """
        its, columns = self._find(name)
        if self._solver is None:
            return np.zeros(len(its.scatter))
        return self._solver.absorbed[columns]

    def errors(self, name: Healthy, sizes: Vector) -> Vector:
        """Errors of sizes over all parts: relative gains, or kicks per orbit [1/m], shape (P,)."""
        its, columns = self._find(name)
        return self._within(sizes, -0.5)[columns] * its.scatter

    def _find(self, name: Healthy) -> tuple[_Part, slice]:
        """What has this name, and where its sizes are among those of all parts."""
        begin = 0
        for part in self._parts:
            end = begin + len(part.scatter)
            if part.name == name:
                return part, slice(begin, end)
            begin = end
        raise KeyError(name)

    @property
    def nothing(self) -> Vector:
        """No errors, shape (P,) over all parts; empty for an exact model."""
        return np.zeros(0 if self._solver is None else self._errors.count)

    def gradient(self, slope: Matrix | Single, sizes: Vector) -> Vector:
        """Derivative of the log posterior by the sizes, in units of their scatter, shape (P,).

        Args:
            slope: λ of what is left, shape (N, n) [1/m].
            sizes: That have been taken out of what is left, shape (P,).
        """
        if self._solver is None:
            return np.zeros(0)
        score = self._errors.score(slope.astype(np.float32, copy=False))
        return self._within(score, -0.5) - sizes

    def step(self, gradient: Vector) -> Vector:
        """Precondition a gradient by the ladder's information, shape (P,)."""
        if self._solver is None:
            return gradient
        return self._within(self._solver.solve(self._within(gradient, 0.5)), 0.5)

    def orbit(self, sizes: Vector) -> Matrix:
        """Tell what errors of these sizes add to the orbit, shape (N, n) [m]."""
        return self.single_orbit(sizes).astype(np.float64)

    def single_orbit(self, sizes: Vector) -> Single:
        """The same in single precision, which is all that there is of it."""
        if not len(sizes):
            return np.zeros((len(self._starts), self._errors.bpms), dtype=np.float32)
        return self._errors.orbit(self._within(sizes, -0.5))

    def _sums(self) -> list[Vector]:
        """Sums of the errors that are known to be nothing, each of shape (P,)."""
        return [
            np.concatenate(
                [part.held if its is part else np.zeros(len(its.scatter)) for its in self._parts]
            )
            for part in self._parts
            if part.held is not None
        ]

    def _within(self, sizes: Vector, power: float) -> Vector:
        """Multiply with a power of 1 + Σ s sᵀ, the precision of all errors, sums s included.

        Sizes are those that scatter by one each, independently; errors are this to the power −½ of
        them. The sums have no error in common.
        """
        for sum_ in self._held:
            norm = float(sum_ @ sum_)
            if norm:
                share = ((1.0 + norm) ** power - 1.0) / norm
                sizes = sizes + (share * float(sum_ @ sizes)) * sum_
        return sizes


def _response_errors(layout: Layout, plane: ChannelPlane, currents: Matrix, share: float) -> _Part:
    """Errors of the response to all that is steered, of a ring whose optics are not known.

    Gradients that are wrong at random kick at random by an orbit: what that adds is distributed
    over the modes of the response as orbits of random kicks are, with the squares of its values.
    A dither steers as many independent orbits as there are correctors, each of which is wrong by
    itself; where a loop steers few, few matter. So those that add most to the orbit are listed.

    Args:
        layout: Devices and model.
        plane: Gradients leave the planes apart.
        currents: That act on the beam, shape (N, m) [A].
        share: Rms of the orbit that is added, of the orbit that is steered.
    """
    rows = layout.bpms.in_plane(plane)
    response = np.zeros_like(layout.response)
    response[rows] = layout.response[rows]
    steered = currents @ response.T
    steered = steered - steered.mean(axis=0)
    squares, shapes = np.linalg.eigh(steered.T @ steered)
    modes, values, _ = np.linalg.svd(response, full_matrices=False)
    scatter = share * values / max(float(np.linalg.norm(values)), 1e-300)
    added = np.outer(np.sqrt(np.maximum(squares, 0.0)), scatter).ravel()
    chosen = np.argsort(-added, kind="stable")[:_MOST_ERRORS]
    chosen = chosen[added[chosen] >= _LEAST * added[chosen[0]]]
    course, mode = np.unravel_index(chosen, (len(squares), len(scatter)))
    weights = np.pad(response.T @ shapes[:, course], ((0, len(response)), (0, 0)))
    name = "response of a ring that is not known"
    return _Part(name, modes[:, mode], weights, scatter[mode])


def _gradient_scatters(layout: Layout) -> Vector:
    """Scatter of the integrated gradient of every quadrupole, shape (P,) [1/m].

    Errors are a share of the strength, the same in both planes. Δβ/β of one error Δk is
    −Δk β cos(…)/(2 sin 2πν): its mean square over places is (Δk β)²/(8 sin² 2πν), and independent
    errors add up. The share is that which beats by `BEAT_RMS` over both planes.
    """
    ring = layout.known_ring
    strength = np.abs(ring.strength("QUAD"))
    if not strength.any():
        strength = np.ones_like(strength)  # magnets of no stated strength are all alike
    beta = ring.table.beta[:, ring.places("QUAD")]
    tunes = np.array([[ring.tune("x")], [ring.tune("y")]])
    beats = (strength * beta / np.sin(2 * np.pi * tunes)) ** 2 / 8.0
    return strength * (BEAT_RMS / np.sqrt(np.sum(beats) / len(beats)))


def _tune_changes(layout: Layout, plane: ChannelPlane) -> Vector:
    """Change of a plane's tune by every integrated gradient, |Δν / Δk| = β / 4π, shape (P,) [m]."""
    ring = layout.known_ring
    return ring.table.beta[plane_row(plane), ring.places("QUAD")] / (4.0 * np.pi)

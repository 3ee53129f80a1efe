"""Gradient errors of quadrupoles: what they make of the orbit of the correctors."""

from collections.abc import Sequence

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.effects.kicks import CALIBRATION, interpolation
from orbitfb.effects.kinds import HEALTHY_CHANGE
from orbitfb.effects.orbit_kinds import Courses
from orbitfb.physics.effect import Effect
from orbitfb.physics.optics import Matrix, green, green_with_gradient_errors, in_thin_lenses
from orbitfb.physics.places import Indices, Ring, plane_row
from orbitfb.records.layout import ChannelPlane, Layout

PLANES: tuple[ChannelPlane, ChannelPlane] = ("x", "y")
HEALTHY_BEAT = 0.015
"""Beta-beat of a ring whose optics were corrected, rms over both planes [1]."""
SIGN = {"x": -1.0, "y": 1.0}
"""An orbit z in a gradient that is Δk too strong is kicked by SIGN · Δk · z."""


def gradient_kicks(
    layout: Layout,
    places: Indices,
    gradients: Matrix,
    currents: Matrix,
    orbit: Matrix | None = None,
) -> Courses:
    """Kicks of quadrupoles with a gradient error, each alone in the ring, both planes.

    Exact for one thin quadrupole: ∓Δk z / (1 ± Δk G_qq) with z the orbit that the correctors make
    there. The orbit that disturbances make there is left out unless the orbit is given: what
    stands still is part of the orbit at the start, and what walks on by some nanometres a tick is
    changed by a few per cent of that, unseen beside the walk itself. (Simulated with disturbances
    that do feel the gradient, the log-likelihood is the same within 0.5 nats at Δk = 0.003, and 8
    to 50 nats of some thousands higher at 0.02, than with the orbit interpolated from the BPMs,
    which brings in the noise of the prediction.)

    Args:
        layout: Devices and ring.
        places: Quadrupoles, of all in the ring, shape (q,).
        gradients: Δk1L, shape (N, q) or (1, q) [1/m].
        currents: That act on the beam, shape (N, m) [A].
        orbit: At the BPMs, shape (N, n) [m]: to be given where gradients change, because then what
            stands still counts; what the correctors do not make of it is interpolated.

    Returns:
        Shape (2, N, q) [rad].
    """
    ring = layout.known_ring
    kicks = np.zeros((2, len(currents), gradients.shape[1]))
    for row, plane in enumerate(PLANES):
        if plane not in layout.planes:
            continue
        own = np.diag(green(ring, "QUAD", "QUAD", plane))[places]
        strength = SIGN[plane] * gradients
        columns = layout.correctors.in_plane(plane)
        at = layout.orbit_at("QUAD", plane)[np.ix_(places, columns)]
        there = currents[:, columns] @ at.T
        if orbit is not None:
            besides = orbit - currents @ layout.response.T
            there += besides @ interpolation(layout, "QUAD", plane)[places].T
        kicks[row] = there * (strength / (1.0 - strength * own))
    return kicks


def response_change(layout: Layout, gradients: Sequence[Vector]) -> Matrix:
    """Change of the response by gradient errors of all quadrupoles together, (n, m) [m/A].

    Args:
        layout: Devices and ring.
        gradients: Δk1L of every quadrupole, plane by plane, shape (q,) each [1/m].
    """
    found = np.zeros_like(layout.response)
    for plane, its in zip(PLANES, gradients, strict=True):
        if plane in layout.planes:
            found += in_thin_lenses(
                layout.orbit_per_kick("QUAD", plane), SIGN[plane] * its,
                green(layout.known_ring, "QUAD", "QUAD", plane), layout.orbit_at("QUAD", plane),
            )  # fmt: skip
    return found


def gradient_scatters(layout: Layout) -> Vector:
    """Scatter of the integrated gradient of every quadrupole of a healthy ring, (q,) [1/m].

    Errors are a share of the strength, the same in both planes. Δβ/β of one error Δk is
    −Δk β cos(…)/(2 sin 2πν): its mean square over places is (Δk β)²/(8 sin² 2πν), and independent
    errors add up. The share is that which beats by `HEALTHY_BEAT` over both planes.
    """
    ring = layout.known_ring
    strength = np.abs(ring.strength("QUAD"))
    if not strength.any():
        strength = np.ones_like(strength)  # magnets of no stated strength are all alike
    beta = ring.table.beta[:, ring.places("QUAD")]
    tunes = np.array([[ring.tune("x")], [ring.tune("y")]])
    beats = (strength * beta / np.sin(2 * np.pi * tunes)) ** 2 / 8.0
    return strength * (HEALTHY_BEAT / np.sqrt(np.sum(beats) / len(beats)))


def nearest_bpms(layout: Layout) -> Indices:
    """The BPM nearest to every corrector of a ring without a table of places, shape (m,).

    Devices stand in the order of the ring, and the correctors among the BPMs evenly.
    """
    found = np.zeros(len(layout.correctors), dtype=np.intp)
    for plane in layout.planes:
        rows, columns = layout.bpms.in_plane(plane), layout.correctors.in_plane(plane)
        share = (np.arange(len(columns)) + 0.5) / max(len(columns), 1)
        found[columns] = np.asarray(rows)[(share * len(rows)).astype(np.intp)]
    return found


def focusing_scatters(layout: Layout) -> Vector:
    """Scatter of the focusing errors at the correctors of a ring without a table, (m,) [1/m].

    All are alike. An error k at corrector a adds −k G_a R_b to the response, G_a the orbit per
    kick and R_b the row of the BPM beside it; independent ones change the response by
    `HEALTHY_CHANGE` of itself, rms.
    """
    per_kick = layout.response / CALIBRATION
    beside = layout.response[nearest_bpms(layout)]
    added = np.sum(per_kick**2, axis=0) * np.sum(beside**2, axis=1)
    share = HEALTHY_CHANGE * np.linalg.norm(layout.response) / np.sqrt(np.sum(added))
    return np.full(len(added), share)


def response_with(layout: Layout, gradients: Vector) -> Matrix:
    """Response of a ring with gradient errors, shape (n, m) [m/A].

    Args:
        layout: Devices and ring.
        gradients: Δk1L of every quadrupole, shape (q,) [1/m].
    """
    ring = layout.known_ring
    found = np.zeros((len(layout.bpms), len(layout.correctors)))
    for plane in layout.planes:
        rows, columns = layout.bpms.in_plane(plane), layout.correctors.in_plane(plane)
        bpms = indices_of(ring, [layout.bpms.names[int(i)] for i in rows])
        sources = indices_of(ring, [layout.correctors.names[int(i)] for i in columns])
        per_kick = green_with_gradient_errors(ring, bpms, sources, plane, gradients)
        calibration = ring.table.calibration[plane_row(plane), sources]
        found[np.ix_(rows, columns)] = per_kick * calibration
    return found


def indices_of(ring: Ring, names: list[str]) -> Indices:
    """Where names stand in the table of places."""
    place = {name: index for index, name in enumerate(ring.table.name)}
    return np.array([place[name] for name in names], dtype=np.intp)


class ChangedGradients(Effect):
    """Quadrupoles whose gradients are wrong, all together, constant or growing with time.

    With D = diag(∓Δk) the orbit gains G_bq s D (1 − s G_qq D)⁻¹ z; the inverse is taken through
    the eigenvalues of G_qq D, so that it costs little when the scale s changes at every tick.

    Args:
        layout: Devices and ring.
        quadrupoles: Positions among the ring's quadrupoles, shape (k,).
        gradients: Δk1L of each (per second if they grow), shape (k,) [1/m].
        growing: Whether they grow with time from nothing.
    """

    def __init__(
        self, layout: Layout, quadrupoles: Indices, gradients: Vector, growing: bool = False
    ) -> None:
        ring = layout.known_ring
        places = ring.places("QUAD")[quadrupoles]
        self._period = layout.period if growing else 0.0
        self._parts: list[tuple[Matrix, Matrix, Vector]] = []
        for plane in layout.planes:
            kick = SIGN[plane] * gradients
            values, vectors = np.linalg.eig(green(ring, places, places, plane) * kick)
            into = np.linalg.solve(vectors, layout.orbit_at(places, plane).astype(complex))
            back = (layout.orbit_per_kick(places, plane) * kick) @ vectors
            self._parts.append((back, into, values))

    def respond(self, orbit: Matrix, currents: Matrix, tick: int) -> Matrix:
        """Add what the errors make of the correctors' orbit."""
        scale = self._period * tick if self._period else 1.0
        if scale == 0.0:
            return orbit
        for back, into, values in self._parts:
            at = into @ currents
            factor = scale / (1.0 - scale * values)
            orbit = orbit + (back @ (factor.reshape(-1, *[1] * (at.ndim - 1)) * at)).real
        return orbit

"""What errors of single elements of the response are worth, device by device.

The errors ε of a device's E elements are normal, of one variance v: with their pull a and their
information H the evidence is ½ aᵀ(1/v + H)⁻¹a − ½ ln |1 + vH|, of which the eigenvectors of H make
sums. A row has H = Σ_b (Ω_b)_ii G_b with the products G_b of all currents, a column
H = Σ_b Ω_b Σ_f u(f)². All devices are ranked with the eigenvectors of their mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from orbitfb.core.signals import Mask, Vector
from orbitfb.diagnose.likelihood.terms import Single
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.laws import ElementsLaw
from orbitfb.estimation.noise import StepNoise
from orbitfb.estimation.priors import FREE_WIDTHS
from orbitfb.estimation.transform import Indices, Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """Errors of the elements of one device.

    Args:
        place: Number of the device.
        evidence: Log evidence [nats].
        cost: What the log likelihood, with these errors, is more than that [nats].
        errors: Of its elements, shape (E,) [m/A].
    """

    place: int
    evidence: float
    cost: float
    errors: Vector

    def share(self, law: ElementsLaw) -> float:
        """Rms of the errors over that of the model's elements."""
        rms = float(np.sqrt(np.mean(self.errors[law.there[self.place]] ** 2)))
        return rms / max(float(law.scale[self.place]), 1e-300)


@dataclass(frozen=True, slots=True, eq=False)
class Courses:
    """What the elements of all devices are driven by.

    Args:
        law: Of the devices.
        spectrum: Transformed steps of the currents, shape (T, m).
        grams: Products of the currents by band, shape (B, m, m).
        space: Of the record, with the healthy errors.
        beside: What these have to do with all devices, once it was asked for.
    """

    law: ElementsLaw
    spectrum: Single
    grams: Matrix
    space: Workspace
    beside: list[Matrix | Single] = field(default_factory=list, init=False)

    @classmethod
    def of(cls, law: ElementsLaw, space: Workspace) -> "Courses":
        """Sum the products of the currents of a record."""
        transform = space.transform
        spectrum = transform.quick_spectrum(space.signals.currents)
        bands = [transform.members(band) for band in range(len(transform.count))]
        parts = [spectrum[rows].astype(np.float64) for rows in bands]
        return cls(law, spectrum, np.stack([part.T @ part for part in parts]), space)

    def cross(self, place: int) -> Matrix:
        """Information between the healthy errors and the elements of one device, shape (k, E)."""
        terms, modes = self.space.terms, self.space.noise.modes
        transform = self.space.transform
        seen, inverse = terms.patterns.T @ modes, self.space.noise.inverse_variance(transform)
        total = np.zeros((len(terms), len(self.law.others)))
        for number, (weight, part) in enumerate(zip(inverse, self._of_all(), strict=True)):
            if self.law.rows:
                along = (seen * weight) @ modes[place]
                total += along[terms.pattern][:, None] * part
            else:
                rows = transform.members(number)
                own = terms.spectrum[rows].T @ self.spectrum[rows, place]
                total += part[terms.pattern] * own[:, None]
        return total

    def _of_all(self) -> Sequence[Matrix | Single]:
        """What of it is of all devices, by band: of the courses, (k, m), or patterns, (P, n)."""
        if not self.beside:
            terms, modes, transform = self.space.terms, self.space.noise.modes, self.space.transform
            seen = terms.patterns.T @ modes
            for number, weight in enumerate(self.space.noise.inverse_variance(transform)):
                rows = transform.members(number)
                if self.law.rows:
                    self.beside.append(terms.spectrum[rows].T @ self.spectrum[rows])
                else:
                    self.beside.append((seen * weight) @ modes.T)
        return self.beside


@dataclass(frozen=True, slots=True, eq=False)
class Free:
    """The elements of all devices under a floor.

    Args:
        courses: That drive them.
        modes: That part walk and noise, shape (n, n) [1/m].
        inverse: Inverse variance of every mode in every band, shape (B, n).
        pulls: Of every element, shape (D, E) [A/m].
    """

    courses: Courses
    modes: Matrix
    inverse: Matrix
    pulls: Matrix

    @classmethod
    def of(cls, courses: Courses, noise: StepNoise, pulled: Matrix) -> "Free":
        """Weigh the elements.

        Args:
            courses: That drive them.
            noise: The floor.
            pulled: Ω z, healthy errors marginalised, shape (T, n) [1/m].
        """
        pulls = (pulled.astype(np.float32).T @ courses.spectrum).astype(np.float64)
        inverse = noise.inverse_variance(courses.space.transform)
        return cls(courses, noise.modes, inverse, pulls if courses.law.rows else pulls.T)

    def information(self, weights: Vector) -> Matrix:
        """Information of a device's elements, or of the mean of several, shape (E, E).

        Args:
            weights: Of a row: (Ω_b)_ii, shape (B,). Of a column: of every mode, shape (n,).
        """
        if self.courses.law.rows:
            return np.einsum("b,bkl->kl", weights, self.courses.grams)
        return (self.modes * weights) @ self.modes.T

    @property
    def weights(self) -> Matrix:
        """What `information` is told by, of every device, shape (D, B) or (D, n)."""
        if self.courses.law.rows:
            return (self.modes**2) @ self.inverse.T
        powers = np.einsum("bkk->kb", self.courses.grams)
        return powers @ self.inverse

    def ranked(self) -> Vector:
        """Log evidence of every device, with the eigenvectors of the mean of all, shape (D,)."""
        law, weights = self.courses.law, self.weights
        gain = np.full(len(law.names), -np.inf)
        for there, devices in _alike(law.there):
            own = self.pulls[np.ix_(devices, there)]
            mean = weights[devices].mean(axis=0)
            level, axes = np.linalg.eigh(self.information(mean)[np.ix_(there, there)])
            size = (weights[devices] @ mean) / max(float(mean @ mean), 1e-300)
            levels = size[:, None] * np.maximum(level, 0.0)
            gain[devices] = _evidence((own @ axes) ** 2, levels, law.scale[devices])[0]
        return gain

    def told(self, place: int, *, beside: bool = False, but: Vector | None = None) -> Told:
        """Tell the elements of one device.

        Args:
            place: Its number.
            beside: Whether the healthy errors are marginalised.
            but: Elements of which any multiple is known to be wrong, shape (E,); None: none.
        """
        law = self.courses.law
        there = np.flatnonzero(law.there[place])
        information = self.information(self.weights[place])[np.ix_(there, there)]
        priors = self.courses.space.priors
        if beside and len(priors.used):
            information = priors.beyond(information, self.courses.cross(place)[:, there])
        own = self.pulls[place, there]
        if but is not None:
            along = information @ but[there]
            length = max(float(but[there] @ along), 1e-300)
            own = own - along * (float(but[there] @ own) / length)
            information = information - np.outer(along, along) / length
        level, axes = np.linalg.eigh(information)
        level, pull = np.maximum(level, 0.0), axes.T @ own
        gain, width = _evidence(pull[None] ** 2, level[None], law.scale[[place]])
        variance = (float(width[0]) * law.scale[place]) ** 2
        mean = variance * pull / (1.0 + variance * level)
        likelihood = float(pull @ mean - 0.5 * np.sum(level * mean**2))
        errors = np.zeros(len(law.others))
        errors[there] = axes @ mean
        return Told(place, float(gain[0]), likelihood - float(gain[0]), errors)


def of_ground(space: Workspace) -> tuple[StepNoise, Matrix]:
    """A floor whose walk is what magnets that move make, and Ω z under it, shape (T, n) [1/m].

    A floor that was estimated without a cause stands in for it at its device, and so do healthy
    errors: they would keep the errors small.
    """
    noise = replace(space.noise, walk=space.shape + space.held)
    return noise, noise.pull(space.residual, space.transform)


def _alike(there: Mask) -> list[tuple[Indices, Indices]]:
    """Elements and devices of every set of devices that have the same elements."""
    kinds, which = np.unique(there, axis=0, return_inverse=True)
    return [
        (np.flatnonzero(one), np.flatnonzero(which.ravel() == number))
        for number, one in enumerate(kinds)
        if np.any(one)
    ]


def _evidence(squares: Matrix, levels: Matrix, scale: Vector) -> tuple[Vector, Vector]:
    """Log evidence of devices with the best width of the errors, and the width, (D,) each.

    Args:
        squares: Pulls along the eigenvectors of the information, squared, shape (D, E).
        levels: Its eigenvalues, shape (D, E).
        scale: Rms of the model's elements, shape (D,).
    """
    gains = []
    for width in FREE_WIDTHS:
        variance = ((width * scale) ** 2)[:, None]
        grown = 1.0 + variance * levels
        gains.append(0.5 * np.sum(variance * squares / grown - np.log(grown), axis=1))
    best = np.argmax(gains, axis=0)
    return np.max(gains, axis=0), np.array(FREE_WIDTHS)[best]
